//! What an orthonormal basis takes from responses, and what it leaves.

use std::iter::repeat_with;

use pulp::Arch;

use crate::error::Error;
use crate::fit::linalg::{self, dot};
use crate::pool::Pool;

/// Responses b in an orthonormal basis Q.
pub(super) struct Residuals {
    /// `b - Q Q^T b`, rows x responses, row-major.
    pub left: Vec<f64>,
    /// `Q^T b`, responses x rank.
    pub projection: Vec<f64>,
    /// Squared lengths of the rows of Q.
    pub leverage: Vec<f64>,
}

impl Residuals {
    /// Of responses (rows x responses) in a basis (rows x rank, row-major); `known`, their projection, spares a pass.
    pub fn new(
        (responses, width): (Vec<f64>, usize),
        (basis, rank): (&[f64], usize),
        known: Option<Vec<f64>>,
        pool: &Pool<'_>,
    ) -> Result<Self, Error> {
        let rows = basis.len().checked_div(rank).unwrap_or(0);
        let mut residuals = Self { left: responses, projection: Vec::new(), leverage: vec![0.0; rows] };
        let project = |block: Block<'_>| {
            linalg::transposed_product(block.basis, block.residuals, rank, width, block.sum);
        };
        let subtract = |block: &mut Block<'_>, projection: &[f64]| {
            for (e, q) in block.residuals.chunks_exact_mut(width.max(1)).zip(block.basis.chunks_exact(rank)) {
                e.iter_mut().zip(projection.chunks_exact(rank)).for_each(|(e, c)| *e -= dot(q, c));
            }
        };
        let mut projection = match known {
            Some(projection) => projection,
            None => residuals.pass(basis, (rank, width), pool, project)?,
        };
        // Once more: residuals far smaller than the responses keep a part in Q that is rounding of the responses.
        let rest = residuals.pass(basis, (rank, width), pool, |mut block| {
            block.leverage.iter_mut().zip(block.basis.chunks_exact(rank)).for_each(|(h, q)| *h = dot(q, q));
            subtract(&mut block, &projection);
            project(block);
        })?;
        residuals.pass(basis, (rank, width), pool, |mut block| subtract(&mut block, &rest))?;
        projection.iter_mut().zip(&rest).for_each(|(c, rest)| *c += rest);
        Ok(Self { projection, ..residuals })
    }

    /// Works on every block; returns the total of what the blocks leave in `sum`. Blocks stay in the cache meanwhile, and depend
    /// on the shape alone, so that no sum depends on who computes it.
    fn pass(
        &mut self,
        basis: &[f64],
        (rank, width): (usize, usize),
        pool: &Pool<'_>,
        work: impl Fn(Block<'_>) + Sync,
    ) -> Result<Vec<f64>, Error> {
        let rows = (CACHED / rank.max(1)).max(16);
        let mut sums = vec![vec![0.0; rank * width]; self.leverage.len().div_ceil(rows)];
        // Without responses there is nothing to cut.
        let residuals = self.left.chunks_mut((rows * width).max(1)).chain(repeat_with(Default::default));
        let blocks = basis.chunks((rows * rank).max(1)).zip(residuals).zip(self.leverage.chunks_mut(rows));
        let blocks = blocks.zip(&mut sums).map(|(((basis, residuals), leverage), sum)| Block {
            basis,
            residuals,
            leverage,
            sum,
        });
        let blocks: Vec<Block<'_>> = blocks.collect();
        pool.run(blocks.into_iter(), Arch::new, |arch, block| arch.dispatch(|| work(block)))?;
        let mut total = vec![0.0; rank * width];
        for sum in &sums {
            total.iter_mut().zip(sum).for_each(|(total, x)| *total += x);
        }
        Ok(total)
    }
}

/// Numbers of a basis that stay in the cache.
const CACHED: usize = 1 << 15;

/// Some rows of a basis, what is left of their responses, their squared lengths, and the block's part of a sum.
struct Block<'a> {
    basis: &'a [f64],
    residuals: &'a mut [f64],
    leverage: &'a mut [f64],
    sum: &'a mut [f64],
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    #[test]
    fn the_mean_leaves_the_deviations_from_it() {
        let never = AtomicBool::new(false);
        for rows in [4, 50_000_usize] {
            let root = (rows as f64).sqrt();
            let basis = vec![root.recip(); rows];
            let responses: Vec<f64> = (0..rows).flat_map(|i| [i as f64, 1e9 + (i % 2) as f64]).collect();
            let means = [(rows - 1) as f64 / 2.0, 1e9 + 0.5];
            for known in [None, Some(means.map(|mean| mean * root).to_vec())] {
                let pool = Pool::new(2, &never);
                let found = Residuals::new((responses.clone(), 2), (&basis, 1), known, &pool).unwrap();
                for (e, b) in found.left.chunks_exact(2).zip(responses.chunks_exact(2)) {
                    assert!((0..2).all(|r| (e[r] - (b[r] - means[r])).abs() < 1e-6));
                }
                assert!((0..2).all(|r| (found.projection[r] / root - means[r]).abs() < 1e-15 * 1e9));
                assert!(found.leverage.iter().all(|h| (h * rows as f64 - 1.0).abs() < 1e-12));
            }
        }
    }

    #[test]
    fn nothing_takes_nothing() {
        let never = AtomicBool::new(false);
        let pool = Pool::new(2, &never);
        let found = Residuals::new((vec![1.0, 2.0], 1), (&[], 0), None, &pool).unwrap();
        assert_eq!(found.left, [1.0, 2.0]);
        let found = Residuals::new((Vec::new(), 0), (&[0.6, 0.8], 1), None, &pool).unwrap();
        assert_eq!((found.leverage, found.projection.len()), (vec![0.36, 0.8 * 0.8], 0));
    }
}
