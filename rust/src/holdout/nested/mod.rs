//! Every leading model at once: model l has the first l columns of the design.
//!
//! Let Q be the basis of an unpivoted factorisation, so that its first l columns span those of model l. For a held-out set K
//! factor `M = I - Q_K^T Q_K = L L^T` without pivoting. With `b = Q c + e`, `u = L^-1 q_i` and
//! `v = L^-1 (Q^T b - Q_K^T b_K) = L^T c - L^-1 Q_K^T e_K`, the prediction of model l at row i is
//!
//! ```text
//! sum_{j <= l} u_j v_j
//! ```
//!
//! since leading blocks of L factor leading blocks of M: the whole curve over l costs one factorisation a set. The
//! second form of v has no cancellation.
//!
//! * **Dual**, for small sets: `S_l = I - Q_K,l Q_K,l^T` loses one rank-one term a column. With `w = S_l-1^-1 q_l` and
//!   `d = 1 - q_l . w`, which is the pivot `L_ll^2`,
//!   `S_l^-1 = S_l-1^-1 + w w^T / d` and the prediction residuals become `e - w (c_l - q_l . e) / d`. The sums have no
//!   cancellation.
//! * **Neighbouring sets** share a [`Gram`](crate::holdout::gram::Gram) matrix: that of a pair is made from that of the pair
//!   before, from that of the next smaller scheme around the same datum (ring by ring), or afresh, whichever takes the
//!   fewest rows.
//! * **Rank loss.** A vanishing pivot at column j leaves models j, j + 1, .. undefined. M squares singular values, so the
//!   error is eps / lambda_min(M); where that shows, the same is done with twice the digits, see
//!   [`crate::holdout::rescue::double_double`]. The training rows' triangle `L^T R`, with R the design's, decides on rank.
//!   Where Q itself has too few digits, at lambda_min near rounding, the training rows are refitted, and their own
//!   triangle gives u and v for all l.

mod curves;
mod dual;
mod rescue;

use std::sync::OnceLock;

use self::curves::{AllModels, Scores, Visited};
use crate::error::Error;
use crate::fit::factor::{self, Factor, Problem};
use crate::fit::linalg;
use crate::holdout::plan;
use crate::holdout::rescue::double_double::DdGram;
use crate::holdout::scheme::{Scheme, check_indices};
use crate::holdout::walk::{Ground, walk};
use crate::pool::Pool;
use crate::sets::Sets;

/// One scheme's scores of every model.
pub struct Curve {
    /// Sum of squared weighted prediction residuals, one a model; NaN where a pair is undefined.
    pub squares: Vec<f64>,
    /// How many of the models are defined, for each pair in the scheme's order.
    pub defined: Vec<usize>,
}

impl Curve {
    /// Notes how many models of a pair are defined.
    fn note(&mut self, schemes: &[Scheme<'_>], visited: Visited, defined: usize) {
        let listed = schemes[visited.scheme].order.is_none();
        self.defined[if listed { visited.pair } else { visited.step }] = defined;
    }
}

/// The fit of one model.
pub struct ModelFit {
    /// Sum of squared weighted residuals.
    pub squares: f64,
    /// Trace of the hat matrix: the effective number of parameters.
    pub parameters: f64,
    /// Number of columns that add rank.
    pub rank: usize,
}

/// A factored problem whose leading columns are models of their own.
pub struct Nested {
    factor: Factor,
    /// The columns that add rank to those before; all of them as a rule.
    kept: Vec<usize>,
    /// The problem without the others, if there are others.
    reduced: Option<(Vec<f64>, Vec<f64>)>,
    /// Weighted responses, rows x responses.
    right: Vec<f64>,
    whole_gram: OnceLock<DdGram>,
}

impl Nested {
    /// Factors all models.
    pub fn new(problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        let mut factor = Factor::new(problem, pool)?;
        let mut kept: Vec<usize> = (0..problem.columns).collect();
        let mut reduced = None;
        while 0 < factor.rank && factor.rank < kept.len() {
            kept = factor.independent_columns(pool)?.into_iter().map(|j| kept[j]).collect();
            let only = |matrix| columns(matrix, problem.columns, &kept);
            let parts = (only(problem.design), only(problem.penalty));
            factor = Factor::new(&part(problem, &parts, kept.len()), pool)?;
            reduced = Some(parts);
        }
        kept.truncate(factor.rank);
        let right = factor::weighted_responses(problem, factor.responses);
        Ok(Self { factor, kept, reduced, right, whole_gram: OnceLock::new() })
    }

    /// How many of the independent columns are among the first ones of the design.
    fn cuts(&self, sizes: &[usize]) -> Result<Vec<usize>, Error> {
        if let Some(index) = (1..sizes.len()).find(|&k| sizes[k] < sizes[k - 1]) {
            return Err(Error::Decreasing { index });
        }
        Ok(sizes.iter().map(|&size| self.kept.partition_point(|&column| column < size)).collect())
    }

    /// The multiply-adds of `fits`.
    pub fn fits_cost(&self) -> f64 {
        self.factor.basis.len() as f64 * (1 + self.factor.responses) as f64
    }

    /// The fit of the models with these numbers of columns.
    pub fn fits(&self, sizes: &[usize], pool: &Pool<'_>) -> Result<Vec<ModelFit>, Error> {
        const FIT_ROWS: usize = 2000;
        let Factor { rank, rows, .. } = self.factor;
        let cuts = self.cuts(sizes)?;
        let width = rank + sizes.len();
        let mut parts = vec![0.0; rows.div_ceil(FIT_ROWS) * width];
        pool.run(
            parts.chunks_exact_mut(width.max(1)).enumerate(),
            || (),
            |(), (block, part)| {
                let (leverage, squares) = part.split_at_mut(rank);
                for i in block * FIT_ROWS..rows.min((block + 1) * FIT_ROWS) {
                    let q = self.factor.basis_row(i);
                    leverage.iter_mut().zip(q).for_each(|(h, q)| *h += q * q);
                    for (c, b) in self.right_row(i).iter().enumerate() {
                        let projection = &self.factor.projection[c * rank..(c + 1) * rank];
                        add_squares([*b], q.as_chunks().0, projection, &cuts, squares);
                    }
                }
            },
        )?;
        let mut sums = vec![0.0; width];
        for part in parts.chunks_exact(width.max(1)) {
            sums.iter_mut().zip(part).for_each(|(s, x)| *s += x);
        }
        let (leverage, squares) = sums.split_at(rank);
        let fit = |(&cut, &squares): (&usize, &f64)| ModelFit {
            squares,
            parameters: leverage[..cut].iter().sum(),
            rank: cut,
        };
        Ok(cuts.iter().zip(squares).map(fit).collect())
    }

    /// The coefficients of the model of the first `size` columns, size x responses, column-major; those of columns that add
    /// no rank are zero.
    pub fn coefficients(&self, size: usize) -> Vec<f64> {
        let Factor { rank, .. } = self.factor;
        let cut = self.kept.partition_point(|&column| column < size);
        self.factor
            .projection
            .chunks_exact(rank.max(1))
            .flat_map(|c| {
                let mut x = c[..cut].to_vec();
                linalg::solve_upper(&self.factor.triangle, rank, cut, &mut x, 1);
                let mut all = vec![0.0; size];
                for ((x, scale), &column) in x.iter().zip(&self.factor.scales).zip(&self.kept) {
                    all[column] = x * scale;
                }
                all
            })
            .collect()
    }

    /// The multiply-adds of `curves`, at most: those of a refit and of a factor with twice the digits for each pair.
    pub fn curves_cost(&self, schemes: &[Scheme<'_>]) -> f64 {
        let pairs: usize = schemes.iter().map(|scheme| scheme.validated.len()).sum();
        pairs as f64 * (self.factor.refit_cost() + 30.0 * (self.factor.rank as f64).powi(3))
    }

    /// Cross-validates the models with these numbers of columns, none less than the one before, by every scheme. Schemes
    /// with equal validated sets and order go through the data together, the smaller first.
    pub fn curves(
        &self,
        problem: &Problem<'_>,
        schemes: &[Scheme<'_>],
        rows: &Sets,
        sizes: &[usize],
        pool: &Pool<'_>,
    ) -> Result<Vec<Curve>, Error> {
        check_indices(rows, self.factor.rows)?;
        schemes.iter().try_for_each(|scheme| scheme.check(rows))?;
        let cuts = self.cuts(sizes)?;
        let chains = plan::chains(schemes);
        let ground = Ground { factor: &self.factor, schemes, rows, hat: None };
        let models = AllModels { ground: &ground, nested: self, cuts: &cuts };
        let portions = plan::portions(&chains, schemes, &self.factor, rows);
        let scores = |count: usize| Scores::new(count, cuts.len());
        let mut parts: Vec<Scores> = portions.iter().map(|p| scores(p.chain.schemes.len())).collect();
        walk(&ground, &models, &portions, &mut parts, pool)?;
        let mut found: Vec<Curve> = schemes
            .iter()
            .map(|s| Curve { squares: vec![0.0; cuts.len()], defined: vec![cuts.len(); s.steps()] })
            .collect();
        let mut rest = Vec::new();
        for (portion, part) in portions.iter().zip(&parts) {
            let squares = part.squares.chunks_exact(cuts.len().max(1));
            for (&s, squares) in portion.chain.schemes.iter().zip(squares) {
                found[s].squares.iter_mut().zip(squares).for_each(|(sum, x)| *sum += x);
            }
            part.cut
                .iter()
                .for_each(|(visited, defined)| found[visited.scheme].note(schemes, *visited, *defined));
            rest.extend_from_slice(&part.close);
        }
        models.rescue(problem, &mut rest, &mut found, pool)?;
        Ok(found)
    }

    /// `Q^T Q` and `Q^T b` in twice the digits, once some pair needs them.
    fn whole_gram(&self, pool: &Pool<'_>) -> Result<&DdGram, Error> {
        if self.whole_gram.get().is_none() {
            let Factor { basis, rank, responses, .. } = &self.factor;
            drop(self.whole_gram.set(DdGram::whole(basis, *rank, &self.right, *responses, pool)?));
        }
        self.whole_gram.get().ok_or(Error::Interrupted)
    }

    fn right_row(&self, i: usize) -> &[f64] {
        let r = self.factor.responses;
        &self.right[i * r..(i + 1) * r]
    }

    /// The problem of the independent columns, which was factored.
    fn independent<'a>(&'a self, problem: &'a Problem<'a>) -> Problem<'a> {
        match &self.reduced {
            Some(parts) => part(problem, parts, self.kept.len()),
            None => Problem { ..*problem },
        }
    }
}

fn columns(matrix: &[f64], width: usize, kept: &[usize]) -> Vec<f64> {
    matrix.chunks_exact(width).flat_map(|row| kept.iter().map(|&j| row[j])).collect()
}

fn part<'a>(
    problem: &Problem<'a>,
    (design, penalty): &'a (Vec<f64>, Vec<f64>),
    columns: usize,
) -> Problem<'a> {
    Problem { design, penalty, columns, ..*problem }
}

/// Adds the squares of `b - sum_{j < cut} u_j v_j` at every cut, of N rows side by side.
fn add_squares<const N: usize>(b: [f64; N], u: &[[f64; N]], v: &[f64], cuts: &[usize], squares: &mut [f64]) {
    let (mut rest, mut done) = (b, 0);
    for (square, &cut) in squares.iter_mut().zip(cuts) {
        for (u, v) in u[done..cut].iter().zip(&v[done..cut]) {
            rest.iter_mut().zip(u).for_each(|(rest, u)| *rest -= u * v);
        }
        done = cut;
        rest.iter().for_each(|e| *square += e * e);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Example, assert_close, bits, pool};

    /// More rows than a task has.
    #[test]
    fn fits_are_those_of_each_model_alone() {
        let example = Example::new(2100, 6, 2);
        let nested = Nested::new(&example.problem(), &pool(2)).unwrap();
        let sizes = [0, 1, 1, 4, 6];
        let [fits, again] = [1, 3].map(|threads| nested.fits(&sizes, &pool(threads)).unwrap());
        let squares = |fits: &[ModelFit]| fits.iter().map(|fit| fit.squares).collect::<Vec<_>>();
        assert_eq!(bits(&squares(&fits)), bits(&squares(&again)));
        for (fit, &size) in fits[1..].iter().zip(&sizes[1..]) {
            let alone = example.lead(size).factor();
            let residuals = &alone.residuals[..2 * 2100];
            let (squares, trace) = (linalg::dot(residuals, residuals), alone.leverage.iter().sum::<f64>());
            assert!((fit.squares / squares - 1.0).abs() < 1e-12);
            assert!((fit.parameters - trace).abs() < 1e-12);
            assert_eq!(fit.rank, size);
            assert_close(&nested.coefficients(size), &alone.coefficients, 1e-12);
        }
        assert_eq!((fits[0].rank, fits[0].parameters), (0, 0.0));
        assert_eq!(nested.fits(&[2, 1], &pool(1)).err(), Some(Error::Decreasing { index: 1 }));
    }

    /// They add no model; whatever is said of the others is said as if they were not there.
    #[test]
    fn columns_that_depend_on_those_before_are_left_out() {
        let mut example = Example::new(30, 5, 2);
        for matrix in [&mut example.design, &mut example.penalty] {
            matrix.chunks_exact_mut(5).for_each(|row| (row[1], row[3]) = (0.0, row[0] - 2.0 * row[2]));
        }
        let nested = Nested::new(&example.problem(), &pool(1)).unwrap();
        assert_eq!(nested.kept, [0, 2, 4]);
        let problem = example.problem();
        let independent = nested.independent(&problem);
        let kept: Vec<f64> = example.design.chunks(5).flat_map(|row| [row[0], row[2], row[4]]).collect();
        assert_eq!((independent.design, independent.columns), (&kept[..], 3));
        let ranks: Vec<usize> =
            nested.fits(&[1, 2, 3, 4, 5], &pool(1)).unwrap().iter().map(|fit| fit.rank).collect();
        assert_eq!(ranks, [1, 1, 2, 2, 3]);
        let coefficients = nested.coefficients(5);
        let residual = |i: usize, c: usize| {
            let row = example.design[5 * i..5 * i + 5].iter().zip(&coefficients[5 * c..5 * c + 5]);
            example.responses[2 * i + c] - row.map(|(a, x)| a * x).sum::<f64>()
        };
        let found: Vec<f64> = (0..60).map(|k| residual(k / 2, k % 2)).collect();
        assert_close(&found, &example.factor().plain_residuals(), 1e-12);
        assert!([1, 3, 6, 8].iter().all(|&j| coefficients[j] == 0.0));
        example.design.fill(0.0);
        example.penalty.fill(0.0);
        let nothing = Nested::new(&example.problem(), &pool(1)).unwrap();
        assert_eq!(nothing.fits(&[5], &pool(1)).unwrap()[0].rank, 0);
        assert!(nothing.coefficients(5).is_empty());
    }

    #[test]
    fn squares_are_those_of_what_a_cut_leaves() {
        let mut squares = [1.0; 4];
        add_squares(
            [5.0, 1.0],
            &[[1.0, 0.0], [2.0, 1.0], [0.0, 3.0]],
            &[2.0, 1.0, -1.0],
            &[0, 1, 1, 3],
            &mut squares,
        );
        // (5, 1), (3, 1) twice, (1, 3).
        assert_eq!(squares, [27.0, 11.0, 11.0, 11.0]);
    }
}
