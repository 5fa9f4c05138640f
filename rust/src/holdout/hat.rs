//! The whole hat matrix of a small problem: each pair then gathers its block.
//!
//! Rows of a basis that hold zeros in the same places are of one *kind*: the x and the y equations of a warp, say, which
//! have unknowns of their own. Columns in which a kind has zeros add nothing to its products, and are left out.

use crate::error::Error;
use crate::fit::factor::Factor;
use crate::fit::linalg;
use crate::pool::{Pool, take};
use crate::sets::Sets;

/// The most rows (72 MB).
pub(super) const HAT_ROWS: usize = 3000;

/// Rows that are one task.
const BAND: usize = 64;

/// The hat matrix, its rows kind after kind, those of a kind in the order of visits: neighbours then share cache lines.
pub(super) struct Hat {
    values: Vec<f64>,
    /// Where each row of the design is.
    pub(super) place: Vec<usize>,
}

impl Hat {
    /// The first rows of each kind are those of the data `first`, in this order, if each comes once.
    pub(super) fn new(
        factor: &Factor,
        rows: &Sets,
        first: impl Iterator<Item = usize>,
        pool: &Pool<'_>,
    ) -> Result<Self, Error> {
        let m = factor.rows;
        let (mut listed, mut order) = (vec![false; m], Vec::with_capacity(m));
        for &row in first.flat_map(|datum| rows.get(datum)).chain(&(0..m).collect::<Vec<_>>()) {
            if !std::mem::replace(&mut listed[row], true) {
                order.push(row);
            }
        }
        let kinds = kinds(factor, &order);
        let (mut place, mut values) = (vec![0; m], vec![0.0; m * m]);
        kinds.iter().flat_map(|kind| &kind.rows).enumerate().for_each(|(k, &row)| place[row] = k);
        let products: Vec<_> =
            kinds.iter().enumerate().map(|(k, kind)| Products::new(factor, &kinds[..k], kind)).collect();
        let (mut rest, mut bands) = (&mut values[..], Vec::new());
        for (kind, products) in kinds.iter().zip(&products) {
            let mine = take(&mut rest, kind.rows.len() * m).chunks_mut(BAND * m).enumerate();
            bands.extend(mine.map(|(band, out)| (products, band * BAND, out)));
        }
        pool.run(bands.into_iter(), || (), |(), (products, first, out)| products.write(first, out, m))?;
        linalg::mirror(&mut values, m);
        Ok(Self { values, place })
    }

    /// The row at a place.
    pub(super) fn line(&self, place: usize) -> &[f64] {
        let m = self.place.len();
        &self.values[place * m..(place + 1) * m]
    }
}

/// Rows that have zeros in all columns but these.
struct Kind {
    rows: Vec<usize>,
    columns: Vec<usize>,
    /// By column, whether it is one of them.
    seen: Vec<bool>,
}

impl Kind {
    /// Its rows in the columns that the other has as well, and how many these are.
    fn packed(&self, factor: &Factor, other: &Self) -> (Vec<f64>, usize) {
        let common: Vec<usize> = self.columns.iter().copied().filter(|&j| other.seen[j]).collect();
        let mut packed = Vec::with_capacity(self.rows.len() * common.len());
        for &row in &self.rows {
            let entries = factor.basis_row(row);
            packed.extend(common.iter().map(|&j| entries[j]));
        }
        (packed, common.len())
    }
}

/// What products of a kind's rows are made of: with those of kinds before, and with each other.
struct Products {
    before: Vec<Across>,
    own: (Vec<f64>, usize),
    /// The place of the first row.
    start: usize,
}

/// Rows of a kind and all of another, which start at a place, in the columns of both.
struct Across {
    mine: Vec<f64>,
    other: Vec<f64>,
    columns: usize,
    start: usize,
}

impl Products {
    /// Of a kind that comes after others.
    fn new(factor: &Factor, before: &[Kind], kind: &Kind) -> Self {
        let mut start = 0;
        let across = |other: &Kind| {
            let (mine, columns) = kind.packed(factor, other);
            let first = start;
            start += other.rows.len();
            Across { mine, other: other.packed(factor, kind).0, columns, start: first }
        };
        let before = before.iter().map(across).collect();
        Self { before, own: kind.packed(factor, kind), start }
    }

    /// Writes the lower triangle for the kind's rows from `first` on, as many as there are lines of `m` numbers.
    fn write(&self, first: usize, out: &mut [f64], m: usize) {
        let rows = first..first + out.len() / m;
        for Across { mine, other, columns, start } in &self.before {
            let mine = &mine[rows.start * columns..rows.end * columns];
            linalg::inner_products(mine, other, *columns, out, (*start, m));
        }
        let (own, columns) = &self.own;
        linalg::gram_rows(own, *columns, first, out, (self.start, m));
    }
}

/// More kinds than these are products too small to be fast.
const MOST_KINDS: usize = 4;

/// All rows by kinds, in the order given; one kind if there would be too many.
fn kinds(factor: &Factor, order: &[usize]) -> Vec<Kind> {
    let mut kinds: Vec<Kind> = Vec::new();
    for &row in order {
        let entries = factor.basis_row(row);
        // Counted to the end, which is faster than to look for the first.
        let others = |kind: &Kind| {
            entries.iter().zip(&kind.seen).map(|(x, &seen)| usize::from((*x != 0.0) != seen)).sum::<usize>()
        };
        if let Some(kind) = kinds.iter_mut().find(|kind| others(kind) == 0) {
            kind.rows.push(row);
            continue;
        }
        if kinds.len() == MOST_KINDS {
            let columns: Vec<usize> = (0..factor.rank).collect();
            return vec![Kind { rows: order.to_vec(), seen: vec![true; columns.len()], columns }];
        }
        let seen: Vec<bool> = entries.iter().map(|&x| x != 0.0).collect();
        let columns = (0..seen.len()).filter(|&j| seen[j]).collect();
        kinds.push(Kind { rows: vec![row], columns, seen });
    }
    kinds
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

    /// Of one kind and of several, of which two have no column in common and one has none at all, and of too many.
    #[test]
    fn zeros_are_left_out_of_products() {
        for (count, expected) in [(1, 1), (2, 2), (3, 3), (4, 4), (5, 1)] {
            let mut factor = Example::new(333, 6, 1).factor();
            for (i, row) in factor.basis.chunks_exact_mut(6).enumerate() {
                let zeros = [0..0, 0..3, 3..6, 0..6, 5..6][i % 7 % count].clone();
                row[zeros].fill(0.0);
            }
            assert_eq!(kinds(&factor, &(0..333).collect::<Vec<_>>()).len(), expected);
            let rows: Sets = (0..333).map(|i| vec![i]).collect();
            let hats =
                [1, 3].map(|threads| Hat::new(&factor, &rows, (0..333).rev(), &pool(threads)).unwrap());
            for i in 0..333 {
                let exact = (0..333).map(|j| linalg::dot(factor.basis_row(i), factor.basis_row(j)));
                let found = (0..333).map(|j| hats[0].line(hats[0].place[i])[hats[0].place[j]]);
                assert_close(&found.collect::<Vec<_>>(), &exact.collect::<Vec<_>>(), 1e-14);
            }
            assert_eq!(bits(&hats[0].values), bits(&hats[1].values));
        }
    }
}
