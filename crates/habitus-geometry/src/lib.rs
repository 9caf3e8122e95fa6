//! Meshes, point clouds and queries on them; knows no body.
