//! Twice the digits, for pairs close to rank loss: `I - Q_K^T Q_K` in double-double arithmetic, and its factor.
//!
//! M squares singular values, so that in plain arithmetic predictions lose 1 / lambda_min(M): twice the digits that a refit
//! of the training rows loses. With twice the digits the closed form is as accurate as the refit, and its cost does not
//! depend on the number of training rows. Q is orthonormal to rounding only, so `Q^T Q`, computed once, replaces I.
//!
//! Matrices are in the panels of [`crate::holdout::kernel`], one of the parts hi and one of the parts lo.

mod arithmetic;
mod factor;
mod gram;

pub use factor::DdFactor;
pub use gram::DdGram;
