//! Closed-form cross-validation of linear least squares, for any hold-out pattern.
//!
//! # The problem
//!
//! Fit `A x ~ b` with m rows and p columns, hold out a set K of rows, predict some of them (T, a subset of K) from the
//! rest, for thousands of sets. Refitting costs m p^2 a set; here only the few sets that nearly lose rank are refitted.
//!
//! # The mathematics
//!
//! Let Q be an orthonormal basis of A's columns, `H = Q Q^T` the hat matrix and `e = b - H b` the residuals.
//!
//! * **Prediction residuals**, equation (6) of Bartoli (IJCV 2016): `e_(K) = (I - H_KK)^-1 e_K`.
//! * **Dual.** `I - H_KK = I - Q_K Q_K^T` is q x q for q held-out rows: cheap for small sets.
//! * **Primal.** By the Woodbury identity `e_(T) = e_T + Q_T M^-1 Q_K^T e_K` with `M = I - Q_K^T Q_K`, p x p: cheap for
//!   large sets. The two cost the same at q = p.
//! * **Chains.** Sets around the same datum nest: one dual factorisation of the largest serves all, see [`holdout`].
//! * **One kernel.** Either is a Cholesky factorisation of `I - X X^T` with the right-hand side carried along as a border, see
//!   [`cholesky`]; only the validated unknowns are solved for.
//! * **Weights** scale rows by their roots; **penalty rows** Z extend A and are never held out, so Q is the top of the
//!   basis of `[A; Z]` and nothing else changes.
//! * **Nested models.** If Q is that of an unpivoted factorisation, leading blocks of M's factor belong to leading columns, and the
//!   predictions of all leading models are cumulative sums, see [`nested`]. Neighbouring sets share M, see [`gram`].
//! * **Rank loss.** `M = Q_-K^T Q_-K`, so a vanishing pivot means that the training rows no longer determine the model: the pair
//!   is *undefined*. Near that, digits are lost, and [`refit`] or [`doubled`] brings them back.
//!
//! # The map
//!
//! | module | idea |
//! |---|---|
//! | [`factor`] | blocked Householder QR: basis, rank, coefficients, residuals, leverage |
//! | [`holdout`] | held-out pairs: which method, and their predictions in parallel |
//! | `plan` | pairs that nest are solved together |
//! | [`nested`] | every leading model at once: whole curves for the price of one model |
//! | [`gram`] | the matrix that neighbouring held-out sets share |
//! | [`doubled`] | the same with twice the digits, for pairs close to rank loss |
//! | [`cholesky`] | the kernel: Gram matrix, factorisation and solve in one recurrence |
//! | `refine` | pairs close to rank loss: the closed form corrected, several at a time |
//! | [`refit`] | pairs that may have lost rank: the training rows reduced anew |
//! | [`neighbours`], [`delaunay`] | which data are near which |
//! | [`matching`] | how many near data to hold out, so that predictions reach as far as the use wants |
//! | [`curve`] | an order in which successive data are near each other |
//! | [`placement`] | Lloyd's algorithm for control points |
//! | [`arrival`] | control points that arrive where residuals are largest |
//! | [`scheme`] | index sets in compressed rows |
//! | [`pool`] | threads, cancellation, `fork` |
//! | [`linalg`] | dense factorisations; the only file that names faer |
//! | `python` | the boundary; the only file that names PyO3 |
//!
//! Start at [`factor::Factor::new`] and [`factor::Factor::predict`].
//!
//! ```
//! use mexpress::factor::{Factor, Problem};
//! use mexpress::holdout::Pairs;
//! use mexpress::pool::Pool;
//! use mexpress::scheme::Sets;
//!
//! let never = std::sync::atomic::AtomicBool::new(false);
//! let pool = Pool::new(1, &never);
//! // A mean of three numbers, each predicted from the other two.
//! let (design, responses) = ([1.0, 1.0, 1.0], [1.0, 2.0, 6.0]);
//! let problem = Problem {
//!     design: &design,
//!     responses: &responses,
//!     root_weights: None,
//!     penalty: &[],
//!     rows: 3,
//!     columns: 1,
//! };
//! let fit = Factor::new(&problem, &pool)?;
//! let alone: Sets = (0..3).map(|i| vec![i]).collect();
//! let pairs = Pairs { held: &alone, validated: &alone, rows: &alone, order: &[] };
//! let found = fit.predict(&problem, &pairs, &pool)?;
//! assert!((found.residuals[2] - 4.5).abs() < 1e-12);
//! # Ok::<(), mexpress::error::Error>(())
//! ```
//!
//! # Promises
//!
//! * Results are the same bit for bit for any number of threads.
//! * No code here is `unsafe`; nothing panics on numbers, whatever they are.
//! * No m x m matrix, unless m is small and it pays (see [`holdout`]).

#![deny(missing_docs)]

pub mod arrival;
pub mod cholesky;
pub mod curve;
pub mod delaunay;
pub mod doubled;
pub mod error;
pub mod factor;
pub mod gram;
pub mod holdout;
pub mod linalg;
pub mod matching;
pub mod neighbours;
pub mod nested;
pub mod placement;
mod plan;
pub mod pool;
#[cfg(feature = "python")]
mod python;
mod refine;
pub mod refit;
pub mod scheme;
