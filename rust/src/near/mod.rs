//! Which data are near which, and in what order they are best visited.

pub mod delaunay;
pub mod distance_matching;
pub mod hilbert;
pub mod neighbours;
mod tree;
