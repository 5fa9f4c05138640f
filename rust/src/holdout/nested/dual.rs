//! Small sets: the inverse of `S_l = I - Q_K,l Q_K,l^T` column by column, and with it the residuals of every leading model.

use super::Nested;
use crate::fit::factor::Factor;
use crate::fit::linalg::dot;

/// Above this lambda_min(M) the inverse, which is updated column by column, keeps its digits.
const LEAST: f64 = 1e-5;

/// The least lambda_min(M) of a pair that the dual may solve: of ill-conditioned designs, training rows may lack rank above
/// that, too.
fn least(factor: &Factor) -> f64 {
    LEAST.max(factor.certain_least())
}

/// Workspace of the dual.
#[derive(Default)]
pub(super) struct Dual {
    /// Q_K, column by column.
    columns: Vec<f64>,
    /// `S_l^-1`, q x q.
    inverse: Vec<f64>,
    /// Prediction residuals of model l, responses x q.
    residuals: Vec<f64>,
    w: Vec<f64>,
}

impl Dual {
    /// Adds the squared residuals of the first `validated` rows at every cut; false if that may be inaccurate.
    pub(super) fn solve(
        &mut self,
        nested: &Nested,
        cuts: &[usize],
        (rows, validated): (&[usize], usize),
        squares: &mut [f64],
    ) -> bool {
        match rows.len() {
            1 => return unrolled::<1>(nested, cuts, (rows, validated), squares),
            2 => return unrolled::<2>(nested, cuts, (rows, validated), squares),
            3 => return unrolled::<3>(nested, cuts, (rows, validated), squares),
            _ => {}
        }
        let (q, rank) = (rows.len(), nested.factor.rank);
        self.load(nested, rows);
        let mut done = 0;
        let required = least(&nested.factor);
        for (square, &cut) in squares.iter_mut().zip(cuts) {
            let projections = || nested.factor.projection.chunks_exact(rank.max(1));
            if !(done..cut).all(|j| self.column(j, q, required, projections())) {
                return false;
            }
            done = cut;
            *square +=
                self.residuals.chunks_exact(q).map(|e| dot(&e[..validated], &e[..validated])).sum::<f64>();
        }
        let trace: f64 = self.inverse.iter().step_by(q + 1).sum();
        trace < q as f64 + 1.0 / required
    }

    fn load(&mut self, nested: &Nested, rows: &[usize]) {
        let (q, rank, responses) = (rows.len(), nested.factor.rank, nested.factor.responses);
        self.columns.resize(q * rank, 0.0);
        self.residuals.resize(q * responses, 0.0);
        self.w.resize(q, 0.0);
        self.inverse.clear();
        self.inverse.resize(q * q, 0.0);
        for (k, &row) in rows.iter().enumerate() {
            self.inverse[k * (q + 1)] = 1.0;
            for (j, x) in nested.factor.basis_row(row).iter().enumerate() {
                self.columns[j * q + k] = *x;
            }
            self.residuals[k..].iter_mut().step_by(q).zip(nested.right_row(row)).for_each(|(e, b)| *e = *b);
        }
    }

    /// Adds column j to the model; false if its pivot vanishes.
    fn column<'a>(
        &mut self,
        j: usize,
        q: usize,
        required: f64,
        projection: impl Iterator<Item = &'a [f64]>,
    ) -> bool {
        let Self { columns, inverse, residuals, w } = self;
        let column = &columns[j * q..(j + 1) * q];
        for (w, row) in w.iter_mut().zip(inverse.chunks_exact(q)) {
            *w = dot(row, column);
        }
        let pivot = 1.0 - dot(w, column);
        if pivot.is_nan() || pivot <= required {
            return false;
        }
        for (e, c) in residuals.chunks_exact_mut(q).zip(projection) {
            let step = (c[j] - dot(column, e)) / pivot;
            e.iter_mut().zip(&*w).for_each(|(e, w)| *e -= w * step);
        }
        for (row, w_row) in inverse.chunks_exact_mut(q).zip(&*w) {
            let factor = w_row / pivot;
            row.iter_mut().zip(&*w).for_each(|(x, w)| *x += factor * w);
        }
        true
    }
}

/// The same for one to three rows, in registers; one response after another.
fn unrolled<const N: usize>(
    nested: &Nested,
    cuts: &[usize],
    (rows, validated): (&[usize], usize),
    squares: &mut [f64],
) -> bool {
    let Nested { factor, .. } = nested;
    let required = least(factor);
    let q: [&[f64]; N] = std::array::from_fn(|k| factor.basis_row(rows[k]));
    for c in 0..factor.responses {
        let projection = &factor.projection[c * factor.rank..(c + 1) * factor.rank];
        let mut inverse: [[f64; N]; N] = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(i == j)));
        let mut e: [f64; N] = std::array::from_fn(|k| nested.right_row(rows[k])[c]);
        let mut done = 0;
        for (square, &cut) in squares.iter_mut().zip(cuts) {
            for j in done..cut {
                let x: [f64; N] = std::array::from_fn(|k| q[k][j]);
                let w = inverse.map(|row| inner(&row, &x));
                let pivot = 1.0 - inner(&w, &x);
                if pivot.is_nan() || pivot <= required {
                    return false;
                }
                let factor = pivot.recip();
                let step = (projection[j] - inner(&x, &e)) * factor;
                for i in 0..N {
                    e[i] -= w[i] * step;
                    (0..N).for_each(|k| inverse[i][k] += w[i] * w[k] * factor);
                }
            }
            done = cut;
            *square += dot(&e[..validated], &e[..validated]);
        }
        let trace: f64 = (0..N).map(|i| inverse[i][i]).sum();
        if trace >= N as f64 + 1.0 / required {
            return false;
        }
    }
    true
}

fn inner<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::holdout::nested::curves::tests::refitted;
    use crate::testing::{Example, assert_close, pool};

    fn nested(example: &Example) -> Nested {
        Nested::new(&example.problem(), &pool(1)).unwrap()
    }

    #[test]
    fn small_sets_are_plain_refits_of_every_model() {
        let example = Example::new(40, 6, 2);
        let (nested, mut dual) = (nested(&example), Dual::default());
        let rows = [30, 4, 17, 5, 39, 11, 0];
        for q in [5, 1, 2, 3, 4, 7] {
            for validated in [1, q] {
                let mut squares = vec![0.0; 6];
                let given = (&rows[..q], validated);
                assert!(dual.solve(&nested, &[1, 2, 3, 4, 5, 6], given, &mut squares));
                assert_close(&squares, &refitted(&example, &rows[..q], &rows[..validated]), 1e-12);
                // They are added to what is there, and cuts may come twice.
                let mut some = vec![1.0; 4];
                assert!(dual.solve(&nested, &[0, 3, 3, 6], given, &mut some));
                assert_close(&some[1..], &[squares[2], squares[2], squares[5]].map(|x| x + 1.0), 1e-12);
            }
        }
    }

    /// What the general way finds of one to three rows, one response after another in registers.
    #[test]
    fn one_to_three_rows_unrolled_are_what_any_number_is() {
        fn check<const N: usize>(nested: &Nested, rows: [usize; N]) {
            let (mut dual, mut general) = (Dual::default(), Vec::new());
            dual.load(nested, &rows);
            for j in 0..5 {
                assert!(dual.column(j, N, LEAST, nested.factor.projection.chunks_exact(5)));
                general.push(dot(&dual.residuals, &dual.residuals));
            }
            let mut squares = vec![0.0; 5];
            assert!(unrolled::<N>(nested, &[1, 2, 3, 4, 5], (&rows, N), &mut squares));
            assert_close(&squares, &general, 1e-14);
        }
        let nested = nested(&Example::new(20, 5, 3));
        check(&nested, [3]);
        check(&nested, [18, 2]);
        check(&nested, [0, 9, 4]);
    }

    #[test]
    fn pairs_of_a_design_near_rank_loss_are_left_to_others() {
        let mut nested = nested(&Example::new(20, 5, 1));
        for rows in [&[3][..], &[3, 4], &[3, 4, 5], &[3, 4, 5, 6]] {
            let mut solve = |least: f64| {
                nested.factor.least = least;
                Dual::default().solve(&nested, &[5], (rows, 1), &mut [0.0])
            };
            assert!(solve(0.1) && !solve(1e-15));
        }
    }

    /// Where the last rows see nearly all of a column, whether a pivot tells or the trace does.
    #[test]
    fn what_may_be_inaccurate_is_left_to_others() {
        for (fraction, accurate) in [(1e-1, true), (1e-4, false), (0.0, false)] {
            let nested = nested(&Example::nearly_lost(30, 3, fraction));
            for rows in [&[28, 29][..], &[29, 3, 28], &[1, 29, 28, 7, 2]] {
                let mut squares = vec![0.0; 3];
                assert_eq!(Dual::default().solve(&nested, &[1, 2, 3], (rows, 1), &mut squares), accurate);
            }
            assert!(Dual::default().solve(&nested, &[2], (&[28, 29], 1), &mut [0.0]));
        }
        // One row's part in two columns, each of which leaves a thousandth.
        let mut example = Example::new(30, 2, 1);
        example.penalty.clear();
        example.design.iter_mut().for_each(|x| *x *= 0.01);
        example.design[58..].copy_from_slice(&[1.0, 30.0]);
        let nested = self::nested(&example);
        for rows in [&[29][..], &[3, 29, 1, 7]] {
            assert!(Dual::default().solve(&nested, &[1], (rows, 1), &mut [0.0]));
            assert!(!Dual::default().solve(&nested, &[1, 2], (rows, 1), &mut [0.0; 2]));
        }
    }
}
