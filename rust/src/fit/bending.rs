//! Rows Z of bending energies ||Z x||^2 that vanish for affine functions, and the splines that bend least.
//!
//! Of weights w with `P^T w = 0`, P the affine functions at the control points, those of a thin-plate spline bend it by
//! `w^T K w`, with K its kernels at the control points. On the complement U of P, `U^T K U` is positive definite.
//!
//! An orthogonal Q, of as many reflections as there are affine functions, has U in its last columns. Whatever is on U is a part
//! of what Q turns, so that nothing is multiplied by U itself. Matrices are column-major.

use crate::error::Error;
use crate::fit::linalg;
use crate::fit::panels::{self, PANEL};
use crate::fit::turn::Turn;
use crate::pool::Pool;

/// Splines that are one at a control point and zero at the others: a column each.
pub struct Cardinal {
    /// Weights of the kernels, then those of the affine functions: (l + a) x l.
    pub weights: Vec<f64>,
    /// Z^T, l x (l - a).
    pub bending: Vec<f64>,
}

/// The cardinal splines of kernels (l x l, symmetric) and affine functions (l x a) at l control points.
///
/// With `P = Q [R; 0]` and `Q^T K Q = [., C; C^T, L L^T]`, `Z = [0, L^-1] Q^T` and weights `Z^T Z`; the affine part is that of
/// what these leave: `P^+ (I - K Z^T Z) = R^-1 [I, -C L^-T L^-1] Q^T`.
pub fn cardinal(kernels: &[f64], affine: &[f64], order: usize, pool: &Pool<'_>) -> Result<Cardinal, Error> {
    let turn = Turn::new(affine.to_vec(), order, affine.len() / order.max(1), pool)?;
    let (width, count) = (turn.columns, order - turn.columns);
    let (across, lower) = turn.split(kernels, pool)?;
    let inverse = inverse_transposed(&lower, count, pool)?;
    let energy = gram(&inverse, count, pool)?;
    let mut part = unit(width);
    part.extend(linalg::product(&across, &energy, width, count, count).into_iter().map(|x| -x));
    linalg::solve_upper(&turn.reflected, order, width, &mut part, order);
    let mut part = linalg::transposed(&part, width);
    turn.apply(&mut part, pool)?;
    let mut weights = turn.side(&energy, count, pool)?;
    weights = turn.side(&linalg::transposed(&weights, order), order, pool)?;
    let columns = weights.chunks(order.max(1)).enumerate();
    let affine = |j: usize| part.iter().skip(j).step_by(order);
    let weights = columns.flat_map(|(j, w)| w.iter().chain(affine(j))).copied().collect();
    Ok(Cardinal { weights, bending: turn.side(&linalg::transposed(&inverse, count), count, pool)? })
}

/// The upper triangle of which the leading parts are the rows Z of the leading functions beyond the affine ones: a kernel each,
/// less shares (l x a) of the first a kernels: `Z^T Z = W^T K W` with `W^T = [-S, I]`. The shares of the first are their own.
///
/// With `U^T K U = L L^T`, Z is the triangle of `L^T U^T W`: what the columns' lengths are costs no digit.
pub fn leading(kernels: &[f64], shares: &[f64], order: usize, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
    let turn = Turn::new(shares.to_vec(), order, shares.len() / order.max(1), pool)?;
    let (width, count) = (turn.columns, order - turn.columns);
    let (_, lower) = turn.split(kernels, pool)?;
    let mut bent = Vec::with_capacity(count * count);
    for column in turn.side(&lower, count, pool)?.chunks(order.max(1)) {
        let (first, rest) = column.split_at(width);
        let at = bent.len();
        bent.extend_from_slice(rest);
        for (share, x) in shares.chunks(order).zip(first) {
            bent[at..].iter_mut().zip(&share[width..]).for_each(|(bent, share)| *bent -= share * x);
        }
    }
    Ok(Turn::new(linalg::transposed(&bent, count), count, count, pool)?.triangle())
}

/// As few rows as have the energy of the given ones (m x l, row-major) on the complement of affine functions (l x a), on which
/// they have none: Z^T, l x (l - a).
pub fn reduced(rows: &[f64], affine: &[f64], order: usize, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
    let turn = Turn::new(affine.to_vec(), order, affine.len() / order.max(1), pool)?;
    let (width, count) = (turn.columns, order - turn.columns);
    let mut turned = rows.to_vec();
    turn.apply_transposed(&mut turned, pool)?;
    let mut bent = Vec::with_capacity(turned.len());
    turned.chunks(order).for_each(|row| bent.extend_from_slice(&row[width..]));
    drop(turned);
    pool.proceed()?;
    let bent = linalg::transposed(&bent, count);
    pool.proceed()?;
    let triangle = Turn::new(bent, rows.len() / order, count, pool)?.triangle();
    turn.side(&linalg::transposed(&triangle, count), count, pool)
}

/// `L^-T`, row-major.
fn inverse_transposed(lower: &[f64], order: usize, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
    let mut inverse = vec![0.0; order * order];
    let panels = inverse.chunks_mut((PANEL * order).max(1)).enumerate();
    pool.run(panels, Vec::new, |lanes, (panel, rows)| {
        let first = panel * PANEL;
        lanes.clear();
        lanes.resize(order - first, [0.0; PANEL]);
        lanes.iter_mut().enumerate().take(PANEL).for_each(|(k, lane)| lane[k] = 1.0);
        panels::solve(&lower[first * (order + 1)..], order, order - first, lanes);
        for (k, row) in rows.chunks_mut(order).enumerate() {
            row[first..].iter_mut().zip(&*lanes).for_each(|(x, lane)| *x = lane[k]);
        }
    })?;
    Ok(inverse)
}

/// Rows of a Gram matrix that are multiplied at once, of a matrix of a thousand columns.
const BAND: usize = 64;

/// `X X^T`, with X (order x order) row-major.
fn gram(rows: &[f64], order: usize, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
    let mut gram = vec![0.0; order * order];
    let band = (BAND * 1000 / order.max(1)).clamp(PANEL, BAND);
    let bands = gram.chunks_mut((band * order).max(1)).enumerate();
    pool.run(bands, || (), |(), (k, out)| linalg::gram_rows(rows, order, k * band, out, (0, order)))?;
    linalg::mirror(&mut gram, order);
    Ok(gram)
}

fn unit(order: usize) -> Vec<f64> {
    (0..order * order).map(|at| f64::from(u8::from(at / order == at % order))).collect()
}

impl Turn {
    /// U times a matrix of some columns.
    fn side(&self, matrix: &[f64], columns: usize, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let mut turned = vec![0.0; self.rows * columns];
        let lower = matrix.chunks((self.rows - self.columns).max(1));
        for (column, lower) in turned.chunks_mut(self.rows.max(1)).zip(lower) {
            column[self.columns..].copy_from_slice(lower);
        }
        self.apply(&mut turned, pool)?;
        Ok(turned)
    }

    /// Of `Q^T K Q` with K symmetric, the part in the first rows and the last columns, and the lower factor of that in the last
    /// ones.
    fn split(&self, kernels: &[f64], pool: &Pool<'_>) -> Result<(Vec<f64>, Vec<f64>), Error> {
        let mut turned = kernels.to_vec();
        self.apply_transposed(&mut turned, pool)?;
        turned = linalg::transposed(&turned, self.rows);
        self.apply_transposed(&mut turned, pool)?;
        let columns = || turned.chunks(self.rows.max(1)).skip(self.columns);
        let across = columns().flat_map(|column| column[..self.columns].iter().copied()).collect();
        let corner = columns().flat_map(|column| column[self.columns..].iter().copied()).collect();
        let lower = panels::cholesky(corner, self.rows - self.columns, pool)?.ok_or(Error::TooNear)?;
        Ok((across, lower))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_close, bits, noise, pool};

    /// Points, kernels and affine functions of thin-plate splines.
    fn splines(order: usize) -> (Vec<f64>, Vec<f64>) {
        let points = noise(2 * order, 4);
        let place = |i: usize| (points[2 * i], points[2 * i + 1]);
        let kernel = |i: usize, j: usize| {
            let ((x, y), (a, b)) = (place(i), place(j));
            let square = (x - a).powi(2) + (y - b).powi(2);
            0.5 * square * square.max(f64::MIN_POSITIVE).ln()
        };
        let affine = (0..3).flat_map(|k| (0..order).map(move |i| (i, k)));
        (
            (0..order * order).map(|at| kernel(at % order, at / order)).collect(),
            affine.map(|(i, k)| [place(i).0, place(i).1, 1.0][k]).collect(),
        )
    }

    #[test]
    fn cardinal_splines_are_one_at_their_points_and_their_weights_bend_them() {
        for order in [3, 4, 20, 70] {
            let (kernels, affine) = splines(order);
            let Cardinal { weights, bending } = cardinal(&kernels, &affine, order, &pool(1)).unwrap();
            let terms = [&kernels[..], &affine[..]].concat();
            assert_close(&linalg::product(&terms, &weights, order, order + 3, order), &unit(order), 1e-11);
            let own: Vec<f64> =
                weights.chunks(order + 3).flat_map(|column| column[..order].to_vec()).collect();
            let size = own.iter().fold(1.0, |size: f64, w| size.max(w.abs()));
            let moments = linalg::product(&linalg::transposed(&affine, order), &own, 3, order, order);
            assert!(moments.iter().all(|moment| moment.abs() < 1e-12 * size));
            // w^T K w of the cardinal splines is their weights.
            let energy =
                linalg::product(&bending, &linalg::transposed(&bending, order), order, order - 3, order);
            let bent = linalg::product(&kernels, &own, order, order, order);
            let expected = linalg::product(&linalg::transposed(&own, order), &bent, order, order, order);
            assert!(energy.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-10 * size));
        }
        // Kernels that bend nothing.
        let (_, affine) = splines(6);
        assert_eq!(cardinal(&[0.0; 36], &affine, 6, &pool(1)).err(), Some(Error::TooNear));
    }

    #[test]
    fn leading_parts_of_the_triangle_have_the_energy_of_leading_weights() {
        let order = 30;
        let (kernels, affine) = splines(order);
        // What the affine functions of the first three points say of the others.
        let corners: Vec<f64> = affine.chunks(order).flat_map(|column| column[..3].to_vec()).collect();
        let cofactors = Turn::new(linalg::transposed(&corners, 3), 3, 3, &pool(1)).unwrap();
        let mut shares = linalg::transposed(&affine, order);
        cofactors.apply_transposed(&mut shares, &pool(1)).unwrap();
        linalg::solve_upper(&cofactors.reflected, 3, 3, &mut shares, order);
        let shares = linalg::transposed(&shares, 3);
        // Of the fourth point on: itself less that.
        let column = |k: usize| {
            let mut column: Vec<f64> = (0..order).map(|i| f64::from(u8::from(i == k))).collect();
            (0..3).for_each(|i| column[i] = -shares[i * order + k]);
            column
        };
        let weights: Vec<f64> = (3..order).flat_map(column).collect();
        let count = order - 3;
        let triangle = leading(&kernels, &shares, order, &pool(1)).unwrap();
        assert!((0..count * count).all(|at| at % count <= at / count || triangle[at] == 0.0));
        let energy = linalg::product(&linalg::transposed(&triangle, count), &triangle, count, count, count);
        let bent = linalg::product(&kernels, &weights, order, order, count);
        let expected = linalg::product(&linalg::transposed(&weights, order), &bent, count, order, count);
        assert_close(&energy, &expected, 1e-12);
    }

    #[test]
    fn fewer_rows_have_the_same_energy_and_none_for_affine_functions() {
        let (order, count) = (12, 40);
        let (_, affine) = splines(order);
        // Rows that see affine functions as far as rounding goes.
        let turn = Turn::new(affine.clone(), order, 3, &pool(1)).unwrap();
        let side = turn.side(&unit(order - 3), order - 3, &pool(1)).unwrap();
        let rows = linalg::product(&noise(count * 9, 8), &linalg::transposed(&side, order), count, 9, order);
        let found = reduced(&linalg::transposed(&rows, count), &affine, order, &pool(1)).unwrap();
        assert_eq!(found.len(), order * (order - 3));
        let energy = linalg::product(&found, &linalg::transposed(&found, order), order, order - 3, order);
        let expected = linalg::product(&linalg::transposed(&rows, count), &rows, order, count, order);
        assert_close(&energy, &expected, 1e-13);
        let bent = linalg::product(&linalg::transposed(&found, order), &affine, order - 3, order, 3);
        assert!(bent.iter().all(|x| x.abs() < 1e-13));
    }

    /// Of more points than a panel, a band or a task has.
    #[test]
    fn no_bit_depends_on_threads() {
        let order = 270;
        let (kernels, affine) = splines(order);
        let rows = noise(order * 300, 5);
        let found = [1, 2, 5].map(|threads| {
            let pool = pool(threads);
            let Cardinal { weights, bending } = cardinal(&kernels, &affine, order, &pool).unwrap();
            let leading = leading(&kernels, &affine, order, &pool).unwrap();
            [weights, bending, leading, reduced(&rows, &affine, order, &pool).unwrap()].map(|x| bits(&x))
        });
        assert!(found.iter().all(|same| *same == found[0]));
    }
}
