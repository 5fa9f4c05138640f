//! The column that takes most of a response, which is taken first, on its own.
//!
//! A response with a large mean is nearly a multiple of the ones. What all columns of a basis take of it is rounded to
//! digits of the response in every row anew; a multiple of one column is taken in one rounding, to digits of what it
//! leaves.

use pulp::Arch;

use crate::error::Error;
use crate::fit::factor::Problem;
use crate::fit::linalg::dot;
use crate::fit::rank::Spectrum;
use crate::pool::Pool;

/// Rows of a block.
const ROWS: usize = 4096;

/// By response, a column of the problem, what brings it near one, and the multiple of what it then is.
pub(super) struct Lead {
    multiples: Vec<(usize, f64, f64)>,
    /// The projection of what is left, responses x rank, to rounding of the responses.
    pub projection: Vec<f64>,
}

impl Lead {
    /// Of responses whose projection on a basis is known; the columns have these scales in the triangle.
    pub fn new(spectrum: &Spectrum, scales: &[f64], mut projection: Vec<f64>) -> Self {
        let rank = spectrum.rank.max(1);
        let mut multiples = Vec::new();
        for along in projection.chunks_exact_mut(rank) {
            let shares: Vec<f64> =
                spectrum.triangle.chunks_exact(rank).map(|column| dot(column, along)).collect();
            let Some(j) = (0..shares.len()).max_by(|&i, &j| shares[i].abs().total_cmp(&shares[j].abs()))
            else {
                continue;
            };
            let column = &spectrum.triangle[j * rank..(j + 1) * rank];
            along.iter_mut().zip(column).for_each(|(x, t)| *x -= shares[j] * t);
            multiples.push((j, scales[j], shares[j] * spectrum.scales[j]));
        }
        Self { multiples, projection }
    }

    /// What the columns leave of the weighted responses and of the zeros of the penalty rows, row by row.
    pub fn left(&self, problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let responses = problem.responses.len() / problem.rows;
        let mut left = problem.responses.to_vec();
        left.resize(problem.total_rows() * responses, 0.0);
        if self.multiples.is_empty() && problem.root_weights.is_none() {
            return Ok(left);
        }
        let tasks = left.chunks_mut((ROWS * responses).max(1)).enumerate();
        pool.run(tasks, Arch::new, |arch, (block, left)| {
            arch.dispatch(|| {
                for (i, left) in left.chunks_exact_mut(responses).enumerate() {
                    let (row, weight) = problem.row(block * ROWS + i);
                    for (left, &(j, scale, multiple)) in left.iter_mut().zip(&self.multiples) {
                        *left = (row[j] * scale).mul_add(-multiple, *left);
                    }
                    left.iter_mut().for_each(|left| *left *= weight);
                }
            });
        })?;
        Ok(left)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Example, pool};

    /// A shift of the responses by a multiple of a column, exact in every digit, changes no digit of what is left.
    #[test]
    fn multiples_of_a_column_leave_the_residuals_as_they_are() {
        for (rows, columns) in [(6, 3), (40, 6), (3000, 9)] {
            for copies in [false, true] {
                let mut example = Example::new(rows, columns, 2);
                let last = columns - 1;
                example.penalty.clear();
                example.responses.iter_mut().for_each(|b| *b = (*b * 1024.0).round() / 1024.0);
                for row in example.design.chunks_exact_mut(columns) {
                    row[last] = 2.0;
                    row[0] = if copies { row[1] } else { row[0] };
                }
                let expected = example.factor().plain_residuals();
                example.responses.iter_mut().for_each(|b| *b += 2.0_f64.powi(40));
                let found = example.factor().plain_residuals();
                for (x, y) in found.iter().zip(&expected) {
                    assert!((x - y).abs() < 1e-13, "{rows} {columns} {copies}: {x} {y}");
                }
            }
        }
    }

    #[test]
    fn the_rest_is_what_a_multiple_leaves() {
        let mut example = Example::new(40, 4, 2);
        example.responses.chunks_exact_mut(2).zip(example.design.chunks_exact(4)).for_each(|(b, a)| {
            b[1] = 3.0 * a[2];
        });
        let problem = example.problem();
        let factor = example.factor();
        assert!(
            factor.residuals[..80].iter().skip(1).step_by(2).any(|e| e.abs() > 1e-6),
            "a penalty bends it"
        );
        let triangle = (0..16).map(|k| f64::from(u8::from(k % 5 == 0))).collect::<Vec<_>>();
        let spectrum = Spectrum::new(&triangle, 4, 4, 40, &pool(1)).unwrap();
        let lead = Lead::new(&spectrum, &[1.0, 1.0, 0.5, 1.0], vec![0.0; 8]);
        assert_eq!(lead.projection, [0.0; 8]);
        let lead = Lead::new(&spectrum, &[1.0, 1.0, 0.5, 1.0], vec![0.0, -2.0, 0.0, 1.0, 0.0, 1.0, 6.0, 0.0]);
        assert_eq!(lead.projection, [0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(lead.multiples, [(1, 1.0, -2.0), (2, 0.5, 6.0)]);
        let left = lead.left(&problem, &pool(2)).unwrap();
        for (i, row) in left.chunks_exact(2).enumerate() {
            let (a, w) = problem.row(i);
            let b = problem.responses_of(i, 2).first().copied().unwrap_or(0.0);
            assert!((row[0] - w * (b + 2.0 * a[1])).abs() < 1e-14);
            assert!(i >= 40 || row[1].abs() < 1e-15);
        }
    }
}
