//! Triangles of cells of rows: all that the other cells need to know of them.
//!
//! The triangle R of rows `[A, b]` has the same squares and products, `R^T R = [A, b]^T [A, b]`, so a fit does not tell the
//! two apart. A matrix that does not fit in memory is kept as the triangles of its cells.

use crate::error::Error;
use crate::fit::linalg::{self, QrScratch};
use crate::fit::survey::power_of_two;
use crate::pool::Pool;

/// The triangles of successive cells of a matrix with so many columns, which is row-major: each square, row-major.
///
/// ```
/// use mexpress::{fit::triangles::triangles, pool::Pool};
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// let found = triangles(&[3.0, 4.0, 5.0, 12.0], 1, 2, &Pool::new(1, &flag))?;
/// assert!(found.iter().zip([5.0, 13.0]).all(|(r, length)| (r.abs() - length).abs() < 1e-14));
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn triangles(matrix: &[f64], columns: usize, cell: usize, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
    if columns == 0 || cell == 0 || !matrix.len().is_multiple_of(columns) {
        return Err(Error::Length { expected: columns.max(1) * cell.max(1), given: matrix.len() });
    }
    let cells = matrix.chunks(cell * columns);
    let mut found = vec![0.0; cells.len() * columns * columns];
    pool.run(
        cells.zip(found.chunks_exact_mut(columns * columns)),
        || (QrScratch::new(cell, columns), Vec::new(), Vec::new()),
        |(scratch, reflected, reflectors), (rows, triangle)| {
            let height = rows.len() / columns;
            reflected.clear();
            reflected.resize(rows.len(), 0.0);
            reflectors.clear();
            reflectors.resize(linalg::reflector_size(height, columns), 0.0);
            // Squares neither over- nor underflow, and no digit changes.
            let largest =
                |j: usize| rows.iter().skip(j).step_by(columns).fold(0.0, |a: f64, x| a.max(x.abs()));
            let scales: Vec<f64> = (0..columns).map(|j| power_of_two(largest(j))).collect();
            for (i, row) in rows.chunks_exact(columns).enumerate() {
                for (j, (x, scale)) in row.iter().zip(&scales).enumerate() {
                    reflected[j * height + i] = x * scale;
                }
            }
            // Once called off, nobody reads the result.
            let _ = linalg::qr_in_place(reflected, height, columns, reflectors, scratch, pool);
            for (i, row) in triangle.chunks_exact_mut(columns).enumerate().take(height) {
                for (j, x) in row.iter_mut().enumerate().skip(i) {
                    *x = reflected[j * height + i] / scales[j];
                }
            }
        },
    )?;
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_close, bits, noise, pool};

    /// Squares and products of the columns of rows.
    fn gram(rows: &[f64], columns: usize) -> Vec<f64> {
        let product = |j: usize, k: usize| rows.chunks(columns).map(|row| row[j] * row[k]).sum();
        (0..columns * columns).map(|at| product(at / columns, at % columns)).collect()
    }

    /// The last cell of fewer rows than columns.
    #[test]
    fn a_triangle_has_the_squares_and_products_of_its_cell() {
        let matrix = noise(5 * 43, 7);
        let found = triangles(&matrix, 5, 20, &pool(1)).unwrap();
        assert_eq!(found.len(), 3 * 25);
        for (triangle, rows) in found.chunks(25).zip(matrix.chunks(100)) {
            assert_close(&gram(triangle, 5), &gram(rows, 5), 1e-14);
            assert!((0..25).all(|at| at % 5 >= at / 5 || triangle[at] == 0.0));
        }
        let all = triangles(&found, 5, 15, &pool(1)).unwrap();
        assert_close(&gram(&all, 5), &gram(&matrix, 5), 1e-14);
        assert_eq!(bits(&found), bits(&triangles(&matrix, 5, 20, &pool(3)).unwrap()));
    }

    #[test]
    fn units_change_no_digit() {
        let matrix = noise(3 * 30, 8);
        let scaled: Vec<f64> = matrix
            .chunks(3)
            .flat_map(|row| [row[0] * 2f64.powi(900), row[1], row[2] * 2f64.powi(-900)])
            .collect();
        let (plain, other) =
            (triangles(&matrix, 3, 30, &pool(1)).unwrap(), triangles(&scaled, 3, 30, &pool(1)).unwrap());
        let back: Vec<f64> = other
            .chunks(3)
            .flat_map(|row| [row[0] * 2f64.powi(-900), row[1], row[2] * 2f64.powi(900)])
            .collect();
        assert_eq!(bits(&plain), bits(&back));
        assert!(triangles(&[0.0; 6], 3, 2, &pool(1)).unwrap().iter().all(|&x| x == 0.0));
    }

    #[test]
    fn what_are_no_rows_is_an_error() {
        assert!(triangles(&[1.0; 7], 3, 2, &pool(1)).is_err());
        assert!(triangles(&[1.0; 6], 3, 0, &pool(1)).is_err());
        assert_eq!(triangles(&[], 3, 2, &pool(1)), Ok(vec![]));
    }
}
