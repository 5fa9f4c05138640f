//! mexpress
pub mod cholesky;
pub mod delaunay;
pub mod error;
pub mod factor;
pub mod holdout;
pub mod linalg;
pub mod neighbours;
pub mod placement;
pub mod pool;
#[cfg(feature = "python")]
mod python;
pub mod refit;
pub mod scheme;
