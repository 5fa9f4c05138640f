//! mexpress
pub mod error;
pub mod pool;
pub mod scheme;
