//! Pairs close to rank loss, where the closed form loses digits: refined, solved with twice the digits, or refitted.

pub mod double_double;
pub(crate) mod refine;
pub mod refit;
