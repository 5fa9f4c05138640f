//! Where control points go: evenly over a region, or where the fit is worst.

pub mod by_residual;
pub mod lloyd;
