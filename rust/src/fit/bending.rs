//! Rows Z of bending energies ||Z x||^2 that vanish for affine functions, and the splines that bend least.
//!
//! Of weights w with `P^T w = 0`, P the affine functions at the control points, those of a thin-plate spline bend it by
//! `w^T K w`, with K its kernels at the control points. On the complement U of P, `U^T K U` is positive definite.
//!
//! Everything here is done on one thread, so that no bit depends on how many there are. Matrices are column-major.

use crate::error::Error;
use crate::fit::linalg::{self, QrScratch};
use crate::fit::panels;
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
/// With `U^T K U = L L^T`, `Z = L^-1 U^T` and weights `Z^T Z`; the affine part is that of what these leave: `P^+ (I - K Z^T Z)`.
pub fn cardinal(kernels: &[f64], affine: &[f64], order: usize, pool: &Pool<'_>) -> Result<Cardinal, Error> {
    let width = affine.len() / order.max(1);
    let split = Split::new(affine, order, width, pool)?;
    let side = split.columns(width..order, pool)?;
    let count = order - width;
    let lower = definite(kernels, &side, order, count, pool)?;
    let mut rows = linalg::transposed(&side, order);
    linalg::solve_lower(&lower, count, &mut rows, order);
    let bending = linalg::transposed(&rows, count);
    let weights = linalg::product(&bending, &rows, order, count, order);
    let mut rest = linalg::product(kernels, &weights, order, order, order);
    rest.iter_mut().for_each(|x| *x = -*x);
    (0..order).for_each(|j| rest[j * (order + 1)] += 1.0);
    let along = linalg::transposed(&split.columns(0..width, pool)?, order);
    let mut part = linalg::product(&along, &rest, width, order, order);
    linalg::solve_upper(&split.reflected, order, width, &mut part, order);
    let columns = weights.chunks(order.max(1)).zip(part.chunks(width.max(1)));
    let weights = columns.flat_map(|(w, a)| w.iter().chain(a)).copied().collect();
    Ok(Cardinal { weights, bending })
}

/// The upper triangle of which the leading parts are the rows Z of the leading columns of weights W (l x k):
/// `Z^T Z = W^T K W`.
///
/// With `W = U T` and `U^T K U = L L^T`, it is `L^T T`: what the columns' lengths are costs no digit.
pub fn leading(kernels: &[f64], weights: &[f64], order: usize, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
    let count = weights.len() / order.max(1);
    let split = Split::new(weights, order, count, pool)?;
    let side = split.columns(0..count, pool)?;
    let lower = definite(kernels, &side, order, count, pool)?;
    let upper = linalg::transposed(&lower, count);
    Ok(linalg::product(&upper, &split.triangle(), count, count, count))
}

/// As few rows as have the energy of the given ones (m x l) on the complement of affine functions (l x a), on which they have
/// none: Z^T, l x (l - a).
pub fn reduced(rows: &[f64], affine: &[f64], order: usize, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
    let (count, width) = (rows.len() / order.max(1), affine.len() / order.max(1));
    let side = Split::new(affine, order, width, pool)?.columns(width..order, pool)?;
    let bent = linalg::product(rows, &side, count, order, order - width);
    let triangle = Split::new(&bent, count, order - width, pool)?.triangle();
    Ok(linalg::product(
        &side,
        &linalg::transposed(&triangle, order - width),
        order,
        order - width,
        order - width,
    ))
}

/// The factor of `U^T K U`, lower.
fn definite(
    kernels: &[f64],
    side: &[f64],
    order: usize,
    count: usize,
    pool: &Pool<'_>,
) -> Result<Vec<f64>, Error> {
    let product = linalg::product(kernels, side, order, order, count);
    let gram = linalg::product(&linalg::transposed(side, order), &product, count, order, count);
    panels::cholesky(gram, count, pool)?.ok_or(Error::TooNear)
}

/// A matrix, reflected to a triangle.
struct Split {
    reflected: Vec<f64>,
    reflectors: Vec<f64>,
    shape: (usize, usize),
}

impl Split {
    fn new(matrix: &[f64], rows: usize, columns: usize, pool: &Pool<'_>) -> Result<Self, Error> {
        let (mut reflected, mut reflectors) =
            (matrix.to_vec(), vec![0.0; linalg::reflector_size(rows, columns)]);
        let mut scratch = QrScratch::new(rows, columns);
        linalg::qr_in_place(&mut reflected, rows, columns, &mut reflectors, &mut scratch, pool)?;
        Ok(Self { reflected, reflectors, shape: (rows, columns) })
    }

    /// Its upper triangle, square.
    fn triangle(&self) -> Vec<f64> {
        let (rows, columns) = self.shape;
        linalg::upper_triangle(&self.reflected, rows, columns)
    }

    /// Columns of its orthogonal factor: the first span its own, the others the complement.
    fn columns(&self, range: std::ops::Range<usize>, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let (rows, columns) = self.shape;
        let mut units = vec![0.0; rows * range.len()];
        range.enumerate().for_each(|(k, unit)| units[k * rows + unit] = 1.0);
        let mut scratch = QrScratch::new(rows, columns.max(units.len() / rows.max(1)));
        linalg::apply_q(&self.reflected, self.shape, &self.reflectors, &mut units, &mut scratch, pool)?;
        Ok(units)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_close, noise, pool};

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

    fn unit(order: usize) -> Vec<f64> {
        (0..order * order).map(|at| f64::from(u8::from(at / order == at % order))).collect()
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
        // Of the fourth point on: itself less what the affine functions of the first three say of it.
        let corners: Vec<f64> = affine.chunks(order).flat_map(|column| column[..3].to_vec()).collect();
        let cofactors = Split::new(&linalg::transposed(&corners, 3), 3, 3, &pool(1)).unwrap();
        let weights: Vec<f64> = (3..order)
            .flat_map(|k| {
                let target = [affine[k], affine[order + k], affine[2 * order + k]];
                let q = linalg::transposed(&cofactors.columns(0..3, &pool(1)).unwrap(), 3);
                let mut shares = linalg::product(&q, &target, 3, 3, 1);
                linalg::solve_upper(&cofactors.reflected, 3, 3, &mut shares, 1);
                let mut column = vec![0.0; order];
                column[k] = 1.0;
                (0..3).for_each(|i| column[i] = -shares[i]);
                column
            })
            .collect();
        let count = order - 3;
        let triangle = leading(&kernels, &weights, order, &pool(1)).unwrap();
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
        let side = Split::new(&affine, order, 3, &pool(1)).unwrap().columns(3..order, &pool(1)).unwrap();
        let rows = linalg::product(&noise(count * 9, 8), &linalg::transposed(&side, order), count, 9, order);
        let found = reduced(&rows, &affine, order, &pool(1)).unwrap();
        assert_eq!(found.len(), order * (order - 3));
        let energy = linalg::product(&found, &linalg::transposed(&found, order), order, order - 3, order);
        let expected = linalg::product(&linalg::transposed(&rows, count), &rows, order, count, order);
        assert_close(&energy, &expected, 1e-13);
        let bent = linalg::product(&linalg::transposed(&found, order), &affine, order - 3, order, 3);
        assert!(bent.iter().all(|x| x.abs() < 1e-13));
    }
}
