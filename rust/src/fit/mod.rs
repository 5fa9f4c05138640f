//! One fit of all rows: the orthonormal basis of a design, and the dense factorisations under it.

pub mod bending;
mod cholesky_qr;
mod extremes;
pub mod factor;
mod householder;
mod jacobi;
pub(crate) mod lead;
pub mod linalg;
mod over_basis;
pub(crate) mod panels;
pub mod penalty_path;
pub(crate) mod rank;
mod residuals;
mod survey;
pub mod triangles;
mod turn;
