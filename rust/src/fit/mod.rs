//! One fit of all rows: the orthonormal basis of a design, and the dense factorisations under it.

pub mod factor;
pub mod linalg;
