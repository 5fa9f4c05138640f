//! The column that takes most of a response, which is taken first, on its own.
//!
//! A response with a large mean is nearly a multiple of the ones. What all columns of a basis take of it is rounded to
//! digits of the response in every row anew; a multiple of one column is taken in one rounding, to digits of what it
//! leaves.

use pulp::Arch;

use crate::error::Error;
use crate::fit::factor::{Problem, weighted_responses};
use crate::fit::linalg::dot;
use crate::fit::rank::Spectrum;
use crate::pool::Pool;

/// Square of a response over that of the multiple up to which it is worth a look at the column: a quarter of its length
/// is left at most.
pub(crate) const WORTH: f64 = 16.0 / 15.0;

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
    pub fn new(problem: &Problem<'_>, spectrum: &Spectrum, scales: &[f64], mut projection: Vec<f64>) -> Self {
        let (rank, responses) = (spectrum.rank.max(1), problem.responses.len() / problem.rows);
        let mut multiples = Vec::new();
        for (c, along) in projection.chunks_exact_mut(rank).enumerate() {
            let columns = spectrum.triangle.chunks_exact(rank).enumerate();
            let (j, share) = columns
                .map(|(j, column)| (j, dot(column, along)))
                .max_by(|(_, x), (_, y)| x.abs().total_cmp(&y.abs()))
                .unwrap_or_default();
            let part = |i| problem.responses_of(i, responses)[c] * problem.row(i).1 / share;
            let taken = (0..problem.rows).map(|i| part(i) * part(i)).sum::<f64>() < WORTH;
            let share = if taken { share } else { 0.0 };
            if let (true, Some(column)) = (taken, spectrum.triangle.get(j * rank..(j + 1) * rank)) {
                along.iter_mut().zip(column).for_each(|(x, t)| *x -= share * t);
            }
            multiples.push((j, scales[j], share * spectrum.scales[j]));
        }
        Self { multiples, projection }
    }

    /// What the columns leave of the weighted responses and of the zeros of the penalty rows, row by row.
    pub fn left(&self, problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let responses = problem.responses.len() / problem.rows;
        if self.multiples.iter().all(|lead| lead.2 == 0.0) {
            return Ok(weighted_responses(problem, responses));
        }
        let mut left = problem.responses.to_vec();
        left.resize(problem.total_rows() * responses, 0.0);
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
    fn what_no_column_takes_most_of_stays_as_it_is() {
        let mut example = Example::new(40, 4, 2);
        example.penalty.clear();
        for (k, (b, a)) in
            example.responses.chunks_exact_mut(2).zip(example.design.chunks_exact(4)).enumerate()
        {
            (b[0], b[1]) = ((k as f64).sin(), 3.0 * a[2]);
        }
        let problem = example.problem();
        let triangle = (0..16).map(|k| f64::from(u8::from(k % 5 == 0))).collect::<Vec<_>>();
        let spectrum = Spectrum::new(&triangle, 4, 4, 40, &pool(1)).unwrap();
        let weighted = |i: usize, c: usize| problem.responses_of(i, 2)[c] * problem.row(i).1;
        let length = (0..40).map(|i| weighted(i, 1).powi(2)).sum::<f64>().sqrt();
        let projection = vec![0.0, -0.1, 0.0, 0.0, 0.0, 1.0, length, 0.0];
        let lead = Lead::new(&problem, &spectrum, &[1.0, 1.0, 0.5, 1.0], projection);
        assert_eq!(lead.projection, [0.0, -0.1, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        let left = lead.left(&problem, &pool(2)).unwrap();
        for (i, row) in left.chunks_exact(2).enumerate() {
            let (a, w) = problem.row(i);
            assert_eq!(row[0], weighted(i, 0));
            assert!((row[1] - w * (3.0 * a[2] - length * 0.5 * a[2])).abs() < 1e-13);
        }
    }
}
