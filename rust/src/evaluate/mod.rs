//! Models at many points: what images ask for.

pub mod bspline;
mod cells;
pub mod hats;
pub mod local;
pub mod preimages;
pub mod spline;
pub mod triangles;
