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
//! * **Chains.** Sets around the same datum nest: one dual factorisation of the largest serves all, see [`holdout::residuals`].
//! * **One kernel.** Either is a Cholesky factorisation of `I - X X^T` with the right-hand side carried along as a border,
//!   see [`holdout::kernel`]; only the validated unknowns are solved for.
//! * **Weights** scale rows by their roots; **penalty rows** Z extend A and are never held out, so Q is the top of the
//!   basis of `[A; Z]` and nothing else changes.
//! * **Nested models.** If Q is that of an unpivoted factorisation, leading blocks of M's factor belong to leading columns,
//!   and the predictions of all leading models are cumulative sums, see [`holdout::nested`]. Neighbouring sets share M,
//!   see [`holdout::gram`].
//! * **Rank loss.** `M = Q_-K^T Q_-K`, so a vanishing pivot means that the training rows no longer determine the model: the
//!   pair is *undefined*. Near that, digits are lost, and [`holdout::rescue`] brings them back.
//!
//! # The map
//!
//! | room | idea |
//! |---|---|
//! | [`fit::factor`] | one fit: basis, rank, coefficients, residuals, leverage |
//! | `fit::cholesky_qr`, `fit::panels` | the basis of a well-conditioned design, by products of matrices |
//! | `fit::householder` | the basis of any design, by blocked reflections |
//! | `fit::rank` | rank, and coefficients from the triangle |
//! | [`fit::triangles`] | what a fit needs to know of rows that do not fit in memory |
//! | [`fit::bending`] | the splines that bend least, and rows of bending energies |
//! | [`fit::penalty_path`] | one penalised design at every weight of its penalty |
//! | [`fit::linalg`] | dense factorisations; the only file that names faer |
//! | [`holdout::scheme`] | what is held out and validated: plain data |
//! | `holdout::plan` | which pairs are visited together, and in what portions |
//! | `holdout::walk` | the walk along pairs, each solved in the cheaper way |
//! | [`holdout::gram`] | the matrix that neighbouring held-out sets share |
//! | `holdout::dual`, `holdout::hat` | small sets, alone or each inside the next; the whole hat matrix where it pays |
//! | [`holdout::kernel`] | Gram matrix, factorisation and solve in one recurrence |
//! | [`holdout::residuals`] | what is asked of pairs: the prediction residuals of one model |
//! | [`holdout::nested`] | or the scores of every leading model: whole curves for the price of one model |
//! | `holdout::spread` | how much prediction residuals vary |
//! | `holdout::rescue::refine` | pairs close to rank loss: the closed form corrected, several at a time |
//! | [`holdout::rescue::double_double`] | the same with twice the digits, for nested models |
//! | [`holdout::rescue::refit`] | pairs that may have lost rank: the training rows reduced anew |
//! | [`batch`] | many small problems in one call |
//! | `batch::lanes`, `batch::pairs` | fits and pairs of problems of one shape, each in a lane of the vectors |
//! | [`near::neighbours`], [`near::delaunay`] | which data are near which |
//! | [`near::distance_matching`] | how many near data to hold out, so that predictions reach as far as the use wants |
//! | [`near::hilbert`] | an order in which successive data are near each other |
//! | [`place::lloyd`] | Lloyd's algorithm for control points |
//! | [`place::by_residual`] | control points that arrive where residuals are largest |
//! | [`evaluate::spline`] | thin-plate splines and their slopes at many points |
//! | [`evaluate::local`] | functions of which few are nonzero at a point, at many points |
//! | [`evaluate::bspline`], [`evaluate::hats`] | B-splines; hat functions over triangles, and outside of them |
//! | [`evaluate::triangles`] | which triangles hold a point |
//! | [`evaluate::preimages`] | which point a piecewise affine map maps to a given one |
//! | [`sets`] | index sets in compressed rows |
//! | [`pool`] | threads, cancellation, `fork` |
//! | [`error`] | what can go wrong |
//! | `python` | the boundary; the only folder that names PyO3 |
//!
//! Start at [`fit::factor::Factor::new`] and [`fit::factor::Factor::predict`].
//!
//! ```
//! use mexpress::fit::factor::{Factor, Problem};
//! use mexpress::holdout::scheme::{Held, Scheme};
//! use mexpress::pool::Pool;
//! use mexpress::sets::Sets;
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
//! let scheme = Scheme { held: Held::Sets(&alone), validated: &alone, order: None };
//! let found = fit.predict(&problem, &[scheme], &alone, &pool)?;
//! assert!((found.residuals[2] - 4.5).abs() < 1e-12);
//! # Ok::<(), mexpress::error::Error>(())
//! ```
//!
//! # Promises
//!
//! * Results are the same bit for bit for any number of threads.
//! * No code here is `unsafe`; nothing panics on numbers, whatever they are.
//! * No m x m matrix, unless m is small and it pays (see `holdout::hat`).

#![deny(missing_docs)]

pub mod batch;
pub mod error;
pub mod evaluate;
pub mod fit;
pub mod holdout;
pub mod near;
pub mod place;
pub mod pool;
#[cfg(feature = "python")]
mod python;
pub mod sets;
#[cfg(test)]
mod testing;
