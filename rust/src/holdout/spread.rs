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
use crate::pool::Pool;
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
    let part = |&size: &usize| {
        let (part, after) = std::mem::take(&mut rest).split_at_mut(size);
        rest = after;
        part
    };
    sizes.iter().map(part).collect()
}
