//! The whole hat matrix of a small problem: each pair then gathers its block.

use crate::error::Error;
use crate::fit::factor::Factor;
use crate::fit::linalg;
use crate::pool::Pool;
use crate::sets::Sets;

/// The most rows (72 MB).
pub(super) const HAT_ROWS: usize = 3000;

/// The hat matrix, its rows in the order of visits: neighbours then share cache lines.
pub(super) struct Hat {
    values: Vec<f64>,
    /// Where each row of the design is.
    pub(super) place: Vec<usize>,
}

impl Hat {
    /// The first rows are those of the data `first`, in this order, if each comes once.
    pub(super) fn new(
        factor: &Factor,
        rows: &Sets,
        first: impl Iterator<Item = usize>,
        pool: &Pool<'_>,
    ) -> Result<Self, Error> {
        const BAND: usize = 64;
        let (m, rank) = (factor.rows, factor.rank);
        let (mut place, mut basis) = (vec![usize::MAX; m], Vec::with_capacity(m * rank));
        let mut next = 0;
        for &row in first.flat_map(|datum| rows.get(datum)).chain(&(0..m).collect::<Vec<_>>()) {
            if place[row] == usize::MAX {
                place[row] = next;
                next += 1;
                basis.extend_from_slice(factor.basis_row(row));
            }
        }
        let mut values = vec![0.0; m * m];
        pool.run(
            values.chunks_mut(BAND * m).enumerate(),
            || (),
            |(), (band, out)| linalg::gram_rows(&basis, rank, band * BAND, out, m),
        )?;
        linalg::mirror(&mut values, m);
        Ok(Self { values, place })
    }

    /// The row at a place.
    pub(super) fn line(&self, place: usize) -> &[f64] {
        let m = self.place.len();
        &self.values[place * m..(place + 1) * m]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Example, assert_close, bits, pool, sets};

    /// Of more rows than a task has, on any number of threads.
    #[test]
    fn lines_are_rows_of_the_hat_matrix_in_the_order_of_visits() {
        let factor = Example::new(150, 6, 1).factor();
        // A datum of two rows comes first, then one that comes again.
        let rows = sets([&[7], &[149, 3], &[0]]);
        let visits = [1, 0, 1];
        let hats =
            [1, 3].map(|threads| Hat::new(&factor, &rows, visits.into_iter(), &pool(threads)).unwrap());
        let hat = &hats[0];
        assert_eq!([149, 3, 7, 0, 1].map(|row| hat.place[row]), [0, 1, 2, 3, 4]);
        for i in 0..150 {
            let expected: Vec<f64> =
                (0..150).map(|j| linalg::dot(factor.basis_row(i), factor.basis_row(j))).collect();
            let found: Vec<f64> = (0..150).map(|j| hat.line(hat.place[i])[hat.place[j]]).collect();
            assert_close(&found, &expected, 1e-14);
        }
        assert_eq!(bits(&hats[0].values), bits(&hats[1].values));
    }
}
