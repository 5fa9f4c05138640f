//! What an orthonormal basis takes from responses, and what it leaves.

use std::iter::repeat_with;

use pulp::{Arch, Simd, WithSimd};

use crate::error::Error;
use crate::fit::linalg::dot;
use crate::pool::{Pool, take};

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
    /// Of what is left of responses (rows x responses) in a basis (rows x rank, row-major), and the projections of what is
    /// left and of the whole, to rounding of the whole.
    pub fn new(
        (left, width): (Vec<f64>, usize),
        (basis, rank): (&[f64], usize),
        (taken, known): (&[f64], Vec<f64>),
        pool: &Pool<'_>,
    ) -> Result<Self, Error> {
        let mut remainder = Remainder::new((left, width), (height(basis, rank), rank));
        remainder.pass(basis, Step { taken: Some(taken), project: true }, pool)?;
        remainder.finish(basis, known, pool)
    }

    /// `Q^T b` alone.
    pub fn projection(
        (responses, width): (Vec<f64>, usize),
        (basis, rank): (&[f64], usize),
        pool: &Pool<'_>,
    ) -> Result<Vec<f64>, Error> {
        let mut remainder = Remainder::new((responses, width), (height(basis, rank), rank));
        remainder.pass(basis, Step { taken: None, project: true }, pool)?;
        Ok(remainder.projection())
    }
}

fn height(basis: &[f64], rank: usize) -> usize {
    basis.len().checked_div(rank).unwrap_or(0)
}

/// What is left of responses while more and more is taken.
pub(super) struct Remainder {
    rank: usize,
    width: usize,
    left: Vec<f64>,
    leverage: Vec<f64>,
    /// Projections, one a part.
    sums: Vec<f64>,
}

impl Remainder {
    /// All of the responses, for a basis of so many rows and of this rank.
    pub fn new((responses, width): (Vec<f64>, usize), (rows, rank): (usize, usize)) -> Self {
        Self { rank, width, left: responses, leverage: vec![0.0; rows], sums: Vec::new() }
    }

    /// All rows in parts of so many, on which steps go on alone. They depend on the shape alone, so that no sum depends on
    /// who computes it.
    pub fn parts(&mut self, rows: usize) -> Vec<Part<'_>> {
        let Self { rank, width, .. } = *self;
        self.sums.clear();
        self.sums.resize(self.leverage.len().div_ceil(rows) * rank * width, 0.0);
        // Without responses there is nothing to cut.
        let sums = self.sums.chunks_mut((rank * width).max(1)).chain(repeat_with(Default::default));
        let left = self.left.chunks_mut((rows * width).max(1)).chain(repeat_with(Default::default));
        let parts = self.leverage.chunks_mut(rows).zip(left).zip(sums);
        parts.map(|((leverage, left), sum)| Part { rank, width, left, leverage, sum }).collect()
    }

    /// What the last steps projected.
    fn projection(&self) -> Vec<f64> {
        let mut total = vec![0.0; self.rank * self.width];
        for sum in self.sums.chunks_exact(total.len().max(1)) {
            total.iter_mut().zip(sum).for_each(|(total, x)| *total += x);
        }
        total
    }

    /// Takes a step with all rows.
    fn pass(&mut self, basis: &[f64], step: Step<'_>, pool: &Pool<'_>) -> Result<(), Error> {
        let rows = (CACHED / self.rank.max(1)).max(16);
        let tasks = basis.chunks((rows * self.rank).max(1)).zip(self.parts(rows));
        pool.run(tasks.collect::<Vec<_>>().into_iter(), || (), |(), (basis, mut part)| part.step(step, basis))
    }

    /// After what is `known` of the projection was taken, however that was done, and the rest projected: residuals far
    /// smaller than the responses keep a part in Q that is rounding of the responses.
    pub fn finish(mut self, basis: &[f64], known: Vec<f64>, pool: &Pool<'_>) -> Result<Residuals, Error> {
        let rest = self.projection();
        self.pass(basis, Step { taken: Some(&rest), project: false }, pool)?;
        let projection = known.iter().zip(&rest).map(|(known, rest)| known + rest).collect();
        Ok(Residuals { left: self.left, projection, leverage: self.leverage })
    }
}

/// Numbers of a basis that stay in the cache.
const CACHED: usize = 1 << 15;

/// What is done with every row: what its responses have along the basis, given their projection, is taken; what is left
/// is projected, and then the row's length measured.
#[derive(Clone, Copy)]
pub(super) struct Step<'a> {
    pub taken: Option<&'a [f64]>,
    pub project: bool,
}

/// Successive rows to come.
pub(super) struct Part<'a> {
    rank: usize,
    width: usize,
    left: &'a mut [f64],
    leverage: &'a mut [f64],
    sum: &'a mut [f64],
}

impl Part<'_> {
    /// Goes on by the rows of a basis, or by as many as there are.
    pub fn step(&mut self, step: Step<'_>, basis: &[f64]) {
        let rows = (basis.len() / self.rank).min(self.leverage.len());
        let (leverage, left) = (take(&mut self.leverage, rows), take(&mut self.left, rows * self.width));
        Arch::new().dispatch(Take {
            step,
            shape: (self.rank, self.width),
            basis,
            left,
            leverage,
            sum: self.sum,
        });
    }
}

struct Take<'a> {
    step: Step<'a>,
    /// Rank and responses.
    shape: (usize, usize),
    basis: &'a [f64],
    left: &'a mut [f64],
    leverage: &'a mut [f64],
    sum: &'a mut [f64],
}

impl WithSimd for Take<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { step, shape: (rank, width), basis, left, leverage, sum } = self;
        for (i, (row, leverage)) in basis.chunks_exact(rank).zip(leverage).enumerate() {
            if step.project && step.taken.is_some() {
                *leverage = dot(row, row);
            }
            for (c, left) in left[i * width..(i + 1) * width].iter_mut().enumerate() {
                let along = c * rank..(c + 1) * rank;
                if let Some(taken) = step.taken {
                    *left -= dot(row, &taken[along.clone()]);
                }
                if step.project {
                    sum[along].iter_mut().zip(row).for_each(|(sum, q)| *sum += q * *left);
                }
            }
        }
    }
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
            let pool = Pool::new(2, &never);
            let projection = Residuals::projection((responses.clone(), 2), (&basis, 1), &pool).unwrap();
            for known in [projection, means.map(|mean| mean * root).to_vec()] {
                let both = (&known[..], known.clone());
                let found = Residuals::new((responses.clone(), 2), (&basis, 1), both, &pool).unwrap();
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
        let found = Residuals::new((vec![1.0, 2.0], 1), (&[], 0), (&[], Vec::new()), &pool).unwrap();
        assert_eq!(found.left, [1.0, 2.0]);
        let found = Residuals::new((Vec::new(), 0), (&[0.6, 0.8], 1), (&[], Vec::new()), &pool).unwrap();
        assert_eq!((found.leverage, found.projection.len()), (vec![0.36, 0.8 * 0.8], 0));
    }
}
