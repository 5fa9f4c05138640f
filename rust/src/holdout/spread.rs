//! Blocks of matrices: those of the hat matrix, and the covariances of prediction residuals.

use std::sync::OnceLock;

use crate::error::Error;
use crate::fit::factor::{Factor, Problem};
use crate::fit::linalg::dot;
use crate::holdout::plan::costs;
use crate::holdout::probes::{PROBES, least_eigenvalue};
use crate::holdout::rescue::refit::Refit;
use crate::holdout::scheme::{Scheme, check_indices};
use crate::holdout::walk::{Ground, Workspace};
use crate::pool::{Pool, take};
use crate::sets::Sets;

impl Factor {
    /// What the prediction residuals of each pair's validated rows vary by, in units of the noise of weighted rows:
    /// `((I - H_KK)^-1)_TT`, row-major, pair after pair; NaN where the training rows lose rank.
    pub fn spread(
        &self,
        problem: &Problem<'_>,
        scheme: &Scheme<'_>,
        rows: &Sets,
        pool: &Pool<'_>,
    ) -> Result<Vec<f64>, Error> {
        check_indices(rows, self.rows)?;
        scheme.check(rows)?;
        let ground = Ground { factor: self, schemes: std::slice::from_ref(scheme), rows, hat: None };
        let size = |pair| rows.total(scheme.validated.get(pair)).pow(2);
        let sizes: Vec<usize> = (0..scheme.validated.len()).map(size).collect();
        let mut blocks = vec![0.0; sizes.iter().sum()];
        let failure = OnceLock::new();
        pool.run(
            cut(&mut blocks, &sizes).into_iter().enumerate(),
            || (Workspace::new(rows.len()), Refit::default()),
            |(workspace, refit), (pair, block)| {
                workspace.list_pair(&ground, 0, pair);
                if !workspace.spread(self, block) {
                    let kept = (&workspace.rows[..], workspace.validated);
                    let _ =
                        refit.spread(self, problem, pool, kept, block).map_err(|error| failure.set(error));
                }
            },
        )?;
        failure.into_inner().map_or(Ok(blocks), Err)
    }

    /// The blocks `H_KK` of the hat matrix for sets of rows: each row-major, one after another.
    pub fn hat_blocks(&self, sets: &Sets, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        check_indices(sets, self.rows)?;
        let sizes: Vec<usize> = (0..sets.len()).map(|s| sets.get(s).len().pow(2)).collect();
        let mut blocks = vec![0.0; sizes.iter().sum()];
        pool.run(
            cut(&mut blocks, &sizes).into_iter().enumerate(),
            || (),
            |(), (s, block)| {
                let rows = sets.get(s);
                let q = rows.len();
                for (i, &row) in rows.iter().enumerate() {
                    for (j, &column) in rows.iter().enumerate().take(i + 1) {
                        let h = dot(self.basis_row(row), self.basis_row(column));
                        (block[i * q + j], block[j * q + i]) = (h, h);
                    }
                }
            },
        )?;
        Ok(blocks)
    }
}

impl Workspace {
    /// `((I - H_KK)^-1)_TT` of the pair at hand: in the dual of unit vectors, in the primal `I + Q_T M^-1 Q_T^T`. False
    /// if the pair is too close to rank loss.
    fn spread(&mut self, factor: &Factor, out: &mut [f64]) -> bool {
        let (q, t) = (self.rows.len(), self.validated);
        let (dual, primal) = costs(q as f64, q as f64, factor.rank, false);
        let (own, least) = if dual <= primal {
            self.fill_dual(factor, None, q, t);
            (0.0, least_eigenvalue(&mut self.system, q, factor.responses))
        } else {
            self.fresh_gram(factor);
            (1.0, self.factor_primal(factor, 0, t))
        };
        if least < factor.closed_form_least() || factor.rank + q > factor.total_rows {
            return false;
        }
        let first = factor.responses + PROBES;
        for i in 0..t {
            for j in 0..=i {
                let sum: f64 = self.system.forward_products(first + i, first + j).sum();
                let c = sum + if i == j { own } else { 0.0 };
                (out[i * t + j], out[j * t + i]) = (c, c);
            }
        }
        true
    }
}

/// Parts of these sizes, one after another.
fn cut<'a>(mut rest: &'a mut [f64], sizes: &[usize]) -> Vec<&'a mut [f64]> {
    sizes.iter().map(|&size| take(&mut rest, size)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::holdout::scheme::Held;
    use crate::testing::{Example, assert_close, pool, sets, singletons};

    #[test]
    fn blocks_of_the_hat_matrix_map_responses_to_their_fit() {
        let mut example = Example::new(20, 3, 1);
        example.penalty.clear();
        let factor = example.factor();
        let whole: Vec<usize> = (0..20).collect();
        let blocks = factor.hat_blocks(&sets([&[4, 1], &whole]), &pool(2)).unwrap();
        let (block, h) = blocks.split_at(4);
        assert_eq!(block, [h[84], h[81], h[24], h[21]]);
        let weighted = |i: usize| example.responses[i] * example.root_weights[i];
        let fitted = h.chunks(20).map(|h| h.iter().enumerate().map(|(j, h)| h * weighted(j)).sum());
        let residuals = example.refit(&[], &whole);
        let expected = (0..20).map(|i| weighted(i) - residuals[i] * example.root_weights[i]);
        assert_close(&fitted.collect::<Vec<f64>>(), &expected.collect::<Vec<f64>>(), 1e-14);
    }

    /// Fewer held-out rows than columns, and more; of those, all are validated or the first.
    #[test]
    fn spreads_are_blocks_of_the_inverse_of_what_is_left() {
        let example = Example::new(60, 8, 1);
        let (factor, rows) = (example.factor(), singletons(60));
        let (few, many): (Vec<usize>, Vec<usize>) = ((10..14).collect(), (20..45).collect());
        let held = sets([&few, &many, &many, &[3]]);
        let validated = sets([&few, &many, &many[..2], &[3]]);
        let scheme = Scheme { held: Held::Sets(&held), validated: &validated, order: None };
        let spreads = factor.spread(&example.problem(), &scheme, &rows, &pool(2)).unwrap();
        let mut rest = &spreads[..];
        for pair in 0..4 {
            let (q, t) = (held.get(pair).len(), validated.get(pair).len());
            let h = factor.hat_blocks(&sets([held.get(pair)]), &pool(1)).unwrap();
            let unit = |i: usize, j: usize| f64::from(u8::from(i == j));
            let (block, after) = rest.split_at(t * t);
            rest = after;
            if t == q {
                // (I - H) C = I.
                let entry =
                    |i: usize, j: usize| (0..q).map(|k| (unit(i, k) - h[i * q + k]) * block[k * q + j]).sum();
                let product: Vec<f64> = (0..q * q).map(|at| entry(at / q, at % q)).collect();
                let one: Vec<f64> = (0..q * q).map(|at| unit(at / q, at % q)).collect();
                assert_close(&product, &one, 1e-13);
            } else {
                let whole = &spreads[16..16 + q * q];
                assert_close(block, &[whole[0], whole[1], whole[q], whole[q + 1]], 1e-13);
            }
        }
    }

    /// Near rank loss the training rows are reduced anew; there the closed form would have lost six digits. A column that
    /// two rows see, the others at a fraction: the spread of the two is that of the two rows that are left.
    #[test]
    fn spreads_near_rank_loss_are_those_of_refits() {
        for (fraction, defined) in [(1e-5, true), (0.0, false)] {
            let mut example = Example::nearly_lost(10, 1, fraction);
            example.root_weights.fill(1.0);
            let (held, rows) = (sets([&[8, 9]]), singletons(10));
            let scheme = Scheme { held: Held::Sets(&held), validated: &held, order: None };
            let spread = example.factor().spread(&example.problem(), &scheme, &rows, &pool(1)).unwrap();
            let a = &example.design;
            let left: f64 = a[..8].iter().map(|a| a * a).sum();
            let expected =
                [1.0 + a[8] * a[8] / left, a[8] * a[9] / left, a[8] * a[9] / left, 1.0 + a[9] * a[9] / left];
            assert_close(&spread, &if defined { expected } else { [f64::NAN; 4] }, 1e-14);
        }
    }
}
