//! One fit of all rows: the orthonormal basis of a design, and the dense factorisations under it.

mod cholesky_qr;
pub mod factor;
mod householder;
pub mod linalg;
mod panels;
pub(crate) mod rank;
