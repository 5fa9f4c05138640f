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
