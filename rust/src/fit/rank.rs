//! Rank, and what else the triangle of a factored design tells.

use crate::error::Error;
use crate::fit::extremes::Extremes;
use crate::fit::linalg::{self, dot};
use crate::pool::Pool;

/// The triangle of a design: its rank, and how coefficients follow.
pub(super) struct Spectrum {
    pub rank: usize,
    columns: usize,
    /// What brings columns to unit length.
    pub scales: Vec<f64>,
    /// The triangle with columns at unit length, in the basis' coordinates: rank x columns.
    pub triangle: Vec<f64>,
    /// A lower bound on its smallest singular value that counts.
    pub least: f64,
    /// Below this, relative to the largest, a singular value is rounding.
    pub tolerance: f64,
    /// The triangle's rows in the basis' coordinates, size x rank, if rank is lost.
    pub turn: Option<Vec<f64>>,
    inverse: Inverse,
}

/// How coefficients follow from the projected responses.
enum Inverse {
    /// R, columns x columns.
    Triangle(Vec<f64>),
    /// `D V S^-1`, columns x rank: D scales columns to unit length, S and V are singular values and right vectors.
    Pseudo(Vec<f64>),
}

impl Spectrum {
    /// Of the upper triangle of a matrix of some height, from a design of `rows`.
    pub fn new(
        stack: &[f64],
        height: usize,
        columns: usize,
        rows: usize,
        pool: &Pool<'_>,
    ) -> Result<Self, Error> {
        let size = height.min(columns);
        let (r, scales) = unit_triangle(stack, height, size, columns);
        let tolerance = rows.max(columns) as f64 * f64::EPSILON;
        // 1 / ||R^-1|| is below the smallest singular value and sqrt(columns) above the largest, so most designs
        // pass without a decomposition.
        let bound = if size == columns { linalg::inverse_norm(&r, columns, pool)?.recip() } else { 0.0 };
        let triangular = || Inverse::Triangle(linalg::upper_triangle(stack, height, columns));
        if bound > 2.0 * tolerance * (columns as f64).sqrt() {
            let inverse = triangular();
            return Ok(Self {
                rank: columns,
                columns,
                scales,
                triangle: r,
                least: bound,
                tolerance,
                turn: None,
                inverse,
            });
        }
        let Revealed { left, triangle, inverse, values } =
            Revealed::new(r.clone(), size, columns, &scales, tolerance, pool)?;
        let (rank, least) = (values.len(), values.last().copied().unwrap_or(0.0));
        // Of full rank after all: the basis stays that of leading columns, and the triangle one.
        let (turn, triangle, inverse) =
            if rank == columns { (None, r, triangular()) } else { (Some(left), triangle, inverse) };
        Ok(Self { rank, columns, scales, triangle, least, tolerance, turn, inverse })
    }

    /// The triangle with columns at their own length, row-major.
    pub fn rows(&self) -> Vec<f64> {
        let row = |i| self.triangle.iter().skip(i).step_by(self.rank);
        (0..self.rank).flat_map(|i| row(i).zip(&self.scales).map(|(x, scale)| x / scale)).collect()
    }

    /// Least-squares coefficients (columns x responses); of least norm, columns at unit length, when rank is lost.
    pub fn solve(&self, projection: &[f64], responses: usize) -> Vec<f64> {
        match &self.inverse {
            Inverse::Triangle(r) => {
                let mut x = projection.to_vec();
                linalg::solve_upper(r, self.rank, self.rank, &mut x, responses);
                x
            }
            Inverse::Pseudo(inverse) => {
                linalg::product(inverse, projection, self.columns, self.rank, responses)
            }
        }
    }
}

/// The R of a factored stack with its columns at unit length (size x columns), and the scales that did it.
fn unit_triangle(stack: &[f64], height: usize, size: usize, columns: usize) -> (Vec<f64>, Vec<f64>) {
    let mut r = vec![0.0; size * columns];
    let mut scales = vec![1.0; columns];
    for (j, column) in r.chunks_exact_mut(size).enumerate() {
        let kept = size.min(j + 1);
        column[..kept].copy_from_slice(&stack[j * height..j * height + kept]);
        let norm = dot(column, column).sqrt();
        if norm > 0.0 {
            scales[j] = norm.recip();
            column.iter_mut().for_each(|x| *x *= scales[j]);
        }
    }
    (r, scales)
}

/// A triangle whose rank took a singular value decomposition, cut to that rank.
struct Revealed {
    left: Vec<f64>,
    values: Vec<f64>,
    /// `S V^T`.
    triangle: Vec<f64>,
    inverse: Inverse,
}

impl Revealed {
    /// Decides as `numpy.linalg.matrix_rank` does.
    fn new(
        r: Vec<f64>,
        size: usize,
        columns: usize,
        scales: &[f64],
        tolerance: f64,
        pool: &Pool<'_>,
    ) -> Result<Self, Error> {
        let linalg::Svd { u: mut left, s: mut values, v } = linalg::thin_svd(r, size, columns, pool)?;
        let rank = numerical_rank(&values, tolerance);
        left.truncate(size * rank);
        values.truncate(rank);
        let mut triangle = vec![0.0; rank * columns];
        let mut inverse = vec![0.0; columns * rank];
        for (i, s) in values.iter().enumerate() {
            for (j, scale) in scales.iter().enumerate() {
                triangle[j * rank + i] = s * v[i * columns + j];
                inverse[i * columns + j] = scale * v[i * columns + j] / s;
            }
        }
        Ok(Self { left, values, triangle, inverse: Inverse::Pseudo(inverse) })
    }
}

/// How many leading columns of a triangle (order x order, column-major) are of full rank, singular values below a
/// fraction of the largest counting as zero. Rank, once lost, stays so: leading blocks interlace.
pub(crate) fn leading_rank(
    triangle: &[f64],
    order: usize,
    tolerance: f64,
    pool: &Pool<'_>,
) -> Result<usize, Error> {
    let column = |j: usize| &triangle[j * order..j * order + j + 1];
    // A diagonal entry bounds the least singular value, the longest column so far the largest: most losses show like this.
    let mut longest = 0.0_f64;
    let vanishing = |&j: &usize| {
        longest = longest.max(dot(column(j), column(j)).sqrt());
        column(j)[j].abs() <= tolerance * longest
    };
    let all = (0..order).find(vanishing).unwrap_or(order);
    let mut extremes = Extremes::new(triangle, order);
    first_deficient(all, |count| {
        pool.proceed()?;
        if let Some(full) = extremes.stands_out(count, tolerance) {
            return Ok(full);
        }
        let mut r = vec![0.0; count * count];
        r.chunks_exact_mut(count).enumerate().for_each(|(j, to)| to[..=j].copy_from_slice(column(j)));
        Ok(numerical_rank(&linalg::thin_svd(r, count, count, pool)?.s, tolerance) == count)
    })
    .map(|first| first.map_or(all, |count| count - 1))
}

/// The smallest number of leading columns that are not of full rank, if all of them are not.
pub(crate) fn first_deficient(
    columns: usize,
    mut full: impl FnMut(usize) -> Result<bool, Error>,
) -> Result<Option<usize>, Error> {
    if columns == 0 || full(columns)? {
        return Ok(None);
    }
    let (mut good, mut bad) = (0, columns);
    while bad - good > 1 {
        let middle = usize::midpoint(good, bad);
        if full(middle)? { good = middle } else { bad = middle }
    }
    Ok(Some(bad))
}

/// How many singular values, in decreasing order, stand out of the rounding of the first.
pub(crate) fn numerical_rank(values: &[f64], tolerance: f64) -> usize {
    let cut = values.first().map_or(0.0, |s| s * tolerance);
    values.iter().take_while(|&&s| s > cut).count()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    static NEVER: AtomicBool = AtomicBool::new(false);

    #[test]
    fn a_triangle_of_full_rank_solves_itself() {
        // 2 x + y = 5, 4 y = 12.
        let spectrum = Spectrum::new(&[2.0, 0.0, 1.0, 4.0], 2, 2, 10, &Pool::new(1, &NEVER)).unwrap();
        assert_eq!((spectrum.rank, spectrum.turn.is_some()), (2, false));
        assert_eq!(spectrum.solve(&[5.0, 12.0], 1), [1.0, 3.0]);
        assert!(spectrum.least > 0.5 && spectrum.least <= 1.0);
    }

    #[test]
    fn without_full_rank_the_solution_is_shortest() {
        // Equal columns share the coefficient.
        let spectrum = Spectrum::new(&[2.0, 0.0, 2.0, 0.0], 2, 2, 10, &Pool::new(1, &NEVER)).unwrap();
        assert_eq!(spectrum.rank, 1);
        let turned = spectrum.turn.as_ref().unwrap();
        let x = spectrum.solve(&[6.0 * turned[0]], 1);
        assert!(x.iter().all(|x| (x - 1.5).abs() < 1e-14));
    }

    #[test]
    fn leading_columns_lose_rank_one_by_one() {
        let pool = Pool::new(1, &NEVER);
        let triangle = [1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1e-17];
        assert_eq!(leading_rank(&triangle, 3, 1e-15, &pool), Ok(2));
        assert_eq!(leading_rank(&triangle, 3, 1e-18, &pool), Ok(3));
        // Of columns that are nothing beside those that follow.
        assert_eq!(leading_rank(&[1e-90, 0.0, 0.0, 1.0], 2, 1e-15, &pool), Ok(1));
        // Kahan's triangle: no diagonal entry is small, yet all columns together are dependent.
        let (order, c) = (60, 0.6_f64);
        let s = (1.0 - c * c).sqrt();
        let entry = |k: usize| match (k % order, k / order) {
            (i, j) if i == j => s.powi(i as i32),
            (i, j) if i < j => -c * s.powi(i as i32),
            _ => 0.0,
        };
        let kahan: Vec<f64> = (0..order * order).map(entry).collect();
        let found = leading_rank(&kahan, order, 1e-14, &pool).unwrap();
        assert!((20..order).contains(&found) && s.powi(found as i32) > 1e-6, "{found}");
    }

    #[test]
    fn the_first_deficient_count_is_found_by_halves() {
        for first in 1..=9 {
            assert_eq!(first_deficient(9, |count| Ok(count < first)), Ok(Some(first)));
        }
        assert_eq!(first_deficient(9, |_| Ok(true)), Ok(None));
        assert_eq!(first_deficient(0, |_| Ok(false)), Ok(None));
    }

    #[test]
    fn singular_values_count_beside_the_largest() {
        assert_eq!(numerical_rank(&[2.0, 1.0, 2e-10], 1e-10), 2);
        assert_eq!(numerical_rank(&[0.0, 0.0], 1e-10), 0);
        assert_eq!(numerical_rank(&[], 1e-10), 0);
    }
}
