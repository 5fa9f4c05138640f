//! Models at many points: what images ask for.

pub mod spline;
