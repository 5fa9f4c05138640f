//! What a change of a response changes elsewhere: the product of a place over the basis with the response's own row of it.

use crate::error::Error;
use crate::fit::factor::Factor;
use crate::fit::linalg;
use crate::fit::panels::{self, PANEL};
use crate::pool::Pool;

/// Panels of a task.
const PANELS: usize = 8;

impl Factor {
    /// `a R^-1` of rows a over the columns of the design, any number of them: with Q_i the row of a response b_i in
    /// [`weighted_basis`](Self::weighted_basis), `a x` grows with b_i by `a R^-1 Q_i^T`. NaN without full rank.
    pub fn over_basis(&self, rows: &[f64], pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let columns = self.columns;
        if self.rank < columns {
            return Ok(vec![f64::NAN; rows.len()]);
        }
        let lower = linalg::transposed(&self.triangle, columns);
        let mut over = vec![0.0; rows.len()];
        let size = PANELS * PANEL * columns;
        let tasks = over.chunks_mut(size).zip(rows.chunks(size));
        pool.run(tasks, Vec::new, |lanes, (over, rows)| {
            let count = rows.len() / columns;
            lanes.clear();
            lanes.resize(count.div_ceil(PANEL) * columns, [0.0; PANEL]);
            let row = |i| (&rows[i * columns..(i + 1) * columns], 1.0);
            panels::pack(row, count, &self.scales, 0, lanes);
            panels::solve(&lower, columns, columns, lanes);
            panels::unpack(lanes, columns, over);
        })?;
        Ok(over)
    }

    /// Rows of the basis times the roots of their weights, those of the penalty left out.
    pub fn weighted_basis(&self) -> Vec<f64> {
        let mut weighted = self.basis[..self.rows * self.rank].to_vec();
        if let (Some(roots), true) = (&self.root_weights, self.rank > 0) {
            for (row, root) in weighted.chunks_exact_mut(self.rank).zip(roots) {
                row.iter_mut().for_each(|q| *q *= root);
            }
        }
        weighted
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::factor::{Factor, Problem};
    use crate::fit::linalg;
    use crate::testing::{Example, assert_close, bits, noise, pool};

    /// A response after another is one more; more rows than a task has, the last panel not whole.
    #[test]
    fn products_with_the_basis_are_what_a_response_changes() {
        let mut example = Example::new(20, 5, 1);
        let factor = example.factor();
        let rows = noise(5 * 70, 9);
        let [over, again] = [1, 3].map(|threads| factor.over_basis(&rows, &pool(threads)).unwrap());
        assert_eq!(bits(&over), bits(&again));
        let basis = factor.weighted_basis();
        let before = factor.coefficients;
        for i in [0, 7, 19] {
            example.responses[i] += 1.0;
            let after = example.factor().coefficients;
            example.responses[i] -= 1.0;
            let changed: Vec<f64> = after.iter().zip(&before).map(|(x, y)| x - y).collect();
            let expected: Vec<f64> = rows.chunks(5).map(|row| linalg::dot(row, &changed)).collect();
            let found: Vec<f64> =
                over.chunks(5).map(|row| linalg::dot(row, &basis[5 * i..5 * i + 5])).collect();
            assert_close(&found, &expected, 1e-12);
        }
    }

    #[test]
    fn without_full_rank_nothing_is_known() {
        let design = [1.0, 2.0, 2.0, 4.0, 3.0, 6.0];
        let problem = Problem {
            design: &design,
            responses: &[1.0, 2.0, 4.0],
            root_weights: None,
            penalty: &[],
            rows: 3,
            columns: 2,
        };
        let factor = Factor::new(&problem, &pool(1)).unwrap();
        assert!(factor.over_basis(&[1.0, 0.0], &pool(1)).unwrap().iter().all(|x| x.is_nan()));
    }
}
