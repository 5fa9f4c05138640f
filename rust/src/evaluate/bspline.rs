//! Uniform bicubic B-splines over a grid, continued along each axis with the value and the slope at its edge.

use crate::evaluate::local::{Jet, Local};

/// Grid lines across one axis; the first and the last are outside the span.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    /// Coordinate of the first line.
    pub low: f64,
    /// Distance of two lines.
    pub step: f64,
    /// Number of lines, four or more.
    pub number: usize,
}

/// The functions of a grid.
#[derive(Clone, Debug)]
pub struct BSplines {
    axes: [Axis; 2],
    order: Vec<usize>,
}

impl BSplines {
    /// The functions of a grid whose lines cross at control points: their indices, row after row. None if these are not
    /// one for each crossing.
    ///
    /// ```
    /// use mexpress::evaluate::{bspline::{Axis, BSplines}, local::Local};
    /// let flag = std::sync::atomic::AtomicBool::new(false);
    /// let axis = Axis { low: -1.0, step: 1.0, number: 4 };
    /// let grid = BSplines::new([axis, axis], (0..16).collect()).unwrap();
    /// let x: Vec<f64> = (0..16).map(|k| (k % 4) as f64 - 1.0).collect();
    /// let values = grid.values(&[0.3, 0.8, 9.0, 0.0], &x, 1, &mexpress::pool::Pool::new(1, &flag))?;
    /// assert!((values[0] - 0.3).abs() < 1e-15 && (values[1] - 9.0).abs() < 1e-12);
    /// # Ok::<(), mexpress::error::Error>(())
    /// ```
    pub fn new(axes: [Axis; 2], order: Vec<usize>) -> Option<Self> {
        let [x, y] = axes;
        let whole = x.number.min(y.number) >= 4 && x.number.checked_mul(y.number) == Some(order.len());
        (whole && order.iter().all(|&k| k < order.len())).then_some(Self { axes, order })
    }
}

impl Local for BSplines {
    const MOST: usize = 16;

    fn count(&self) -> usize {
        self.order.len()
    }

    #[inline]
    fn visit(&self, point: [f64; 2], mut take: impl FnMut(usize, Jet)) {
        let [x, y] = self.axes;
        let ((column, across), (row, up)) = (x.nonzero(point[0]), y.nonzero(point[1]));
        for (j, (up, rise)) in up.into_iter().enumerate() {
            let functions = &self.order[(row + j) * x.number + column..][..4];
            for (function, (across, run)) in functions.iter().zip(across) {
                take(*function, [up * across, up * run, rise * across]);
            }
        }
    }
}

impl Axis {
    /// The first of the four functions that are nonzero at a coordinate, and their values and derivatives.
    #[inline]
    fn nonzero(&self, coordinate: f64) -> (usize, [(f64, f64); 4]) {
        let cells = self.number - 3;
        let place = (coordinate - self.low) / self.step - 1.0;
        let inside = place.clamp(0.0, cells as f64);
        let first = (inside as usize).min(cells - 1);
        let (u, beyond) = (inside - first as f64, place - inside);
        let v = 1.0 - u;
        let values = [
            v * v * v / 6.0,
            (4.0 + u * u * (3.0 * u - 6.0)) / 6.0,
            (4.0 + v * v * (3.0 * v - 6.0)) / 6.0,
            u * u * u / 6.0,
        ];
        let slopes = [-v * v / 2.0, u * (1.5 * u - 2.0), v * (2.0 - 1.5 * v), u * u / 2.0];
        (first, std::array::from_fn(|a| (values[a] + beyond * slopes[a], slopes[a] / self.step)))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::pool::Pool;

    fn grid() -> BSplines {
        let axes = [Axis { low: -3.0, step: 2.0, number: 6 }, Axis { low: 1.0, step: 0.5, number: 5 }];
        BSplines::new(axes, (0..30).map(|k| (k * 7) % 30).collect()).unwrap()
    }

    #[test]
    fn elements_sum_to_one_and_slopes_are_the_limits_of_differences() {
        let (grid, flag) = (grid(), AtomicBool::new(false));
        let pool = Pool::new(2, &flag);
        let parameters: Vec<f64> = (0..30).map(|k| (0.618 * f64::from(k)).fract()).collect();
        let points: Vec<f64> = (0..200).map(|k| 9.0 * (0.7548 * f64::from(k)).fract() - 3.0).collect();
        assert_eq!(grid.values(&points, &[1.0; 30], 1, &pool).unwrap().len(), 100);
        for one in grid.values(&points, &[1.0; 30], 1, &pool).unwrap() {
            assert!((one - 1.0).abs() < 1e-13);
        }
        let slopes = grid.slopes(&points, &parameters, 1, &pool).unwrap();
        for axis in 0..2 {
            let at = |step: f64| {
                let moved = points.iter().enumerate().map(|(i, x)| if i % 2 == axis { x + step } else { *x });
                grid.values(&moved.collect::<Vec<_>>(), &parameters, 1, &pool).unwrap()
            };
            for (i, (high, low)) in at(1e-6).iter().zip(at(-1e-6)).enumerate() {
                assert!((slopes[2 * i + axis] - (high - low) / 2e-6).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn a_point_that_is_none_and_grids_that_are_none() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(1, &flag);
        assert!(grid().values(&[f64::NAN, 2.0], &[1.0; 30], 1, &pool).unwrap()[0].is_nan());
        assert!(grid().values(&[], &[1.0; 30], 1, &pool).unwrap().is_empty());
        assert!(grid().values(&[0.0, 2.0], &[1.0; 29], 1, &pool).is_err());
        let axis = Axis { low: 0.0, step: 1.0, number: 4 };
        assert!(BSplines::new([axis, axis], (0..15).collect()).is_none());
        assert!(BSplines::new([axis, axis], (1..17).collect()).is_none());
        let endless = Axis { number: 1 << (usize::BITS - 2), ..axis };
        assert!(BSplines::new([endless, axis], Vec::new()).is_none());
    }
}
