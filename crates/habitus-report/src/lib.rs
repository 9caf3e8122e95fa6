//! A run folder as one self-contained HTML file, and pictures of meshes.
