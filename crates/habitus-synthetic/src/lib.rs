//! People, motions, simulated garments and captures of them, with exact truth.
