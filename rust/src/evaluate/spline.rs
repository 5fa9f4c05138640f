//! Thin-plate splines and their slopes at many points.
//!
//! A spline is `f(q) = sum_k w_k phi(|q - c_k|) + a . (x, y, 1)` with `phi(r) = r^2 log r`. The logarithm is what costs: it is
//! written without branches and tables, so that the compiler makes vector code of it for whatever the processor has.
//! Points are taken a tile at a time, and every centre is added to all of the tile: sums have the order of the centres, and
//! neither threads nor the width of vectors change a bit.

use pulp::{Arch, Simd, WithSimd};

use crate::error::Error;
use crate::pool::Pool;

/// Points of a tile: their sums stay in the first-level cache.
const TILE: usize = 64;

/// Centres whose kernels are kept at hand while one spline after another takes them: its sums stay in registers.
const CENTRES: usize = 16;

/// Evaluations of the kernel that a task should be worth: waking a thread costs about as much as a tenth of these.
const TASK: usize = 1 << 16;

/// Splines that share their centres.
#[derive(Clone, Copy)]
pub struct Splines<'a> {
    /// x and y of the centres in turn.
    pub centres: &'a [f64],
    /// A row of `columns` numbers for each centre, then one each for x, y and 1.
    pub weights: &'a [f64],
    /// Number of splines.
    pub columns: usize,
}

impl Splines<'_> {
    /// The splines at points, which are x and y in turn: a row of `columns` numbers each.
    ///
    /// ```
    /// use mexpress::{evaluate::spline::Splines, pool::Pool};
    /// let flag = std::sync::atomic::AtomicBool::new(false);
    /// let bowl = Splines { centres: &[0.0, 0.0], weights: &[1.0, 0.0, 0.0, 5.0], columns: 1 };
    /// let values = bowl.values(&[0.0, 0.0, 3.0, 4.0], &Pool::new(1, &flag))?;
    /// assert_eq!(values[0], 5.0);
    /// assert!((values[1] - 5.0 - 25.0 * 5_f64.ln()).abs() < 1e-12);
    /// # Ok::<(), mexpress::error::Error>(())
    /// ```
    pub fn values(&self, points: &[f64], pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        self.tiled::<false>(points, pool)
    }

    /// The derivatives along x and y at points: `columns` pairs each.
    pub fn slopes(&self, points: &[f64], pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        self.tiled::<true>(points, pool)
    }

    fn tiled<const SLOPES: bool>(&self, points: &[f64], pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let count = self.centres.len() / 2;
        if self.weights.len() != (count + 3) * self.columns {
            return Err(Error::Length { expected: (count + 3) * self.columns, given: self.weights.len() });
        }
        let width = if SLOPES { 2 * self.columns } else { self.columns };
        let mut rows = vec![0.0; points.len() / 2 * width];
        if rows.is_empty() {
            return Ok(rows);
        }
        let share = TASK.div_ceil(count.max(1) * TILE) * TILE;
        let tasks = points.chunks(2 * share).zip(rows.chunks_mut(width * share));
        let sums = || vec![[0.0; TILE]; width];
        pool.run(tasks, sums, |sums, (points, rows)| {
            for (points, rows) in points.chunks(2 * TILE).zip(rows.chunks_mut(width * TILE)) {
                Arch::new().dispatch(Add::<SLOPES> { splines: self, tile: Tile::of(points), sums });
                for (i, row) in rows.chunks_mut(width).enumerate() {
                    row.iter_mut().zip(&*sums).for_each(|(number, sum)| *number = sum[i]);
                }
            }
        })?;
        Ok(rows)
    }

    #[inline(always)]
    fn add_values(&self, tile: &Tile, sums: &mut [[f64; TILE]]) {
        let (kernels, affine) = self.weights.split_at(self.weights.len() - 3 * self.columns);
        let (along, rest) = affine.split_at(self.columns);
        let (up, constant) = rest.split_at(self.columns);
        for (c, sum) in sums.iter_mut().enumerate() {
            for (i, sum) in sum.iter_mut().enumerate() {
                *sum = tile.x[i] * along[c] + tile.y[i] * up[c] + constant[c];
            }
        }
        let mut kept = [[0.0; TILE]; CENTRES];
        let (centres, _) = self.centres.as_chunks();
        for (centres, weights) in centres.chunks(CENTRES).zip(kernels.chunks(CENTRES * self.columns)) {
            for (centre, phi) in centres.iter().zip(&mut kept) {
                for (i, phi) in phi.iter_mut().enumerate() {
                    let squared = tile.squared_distance(i, centre);
                    *phi = 0.5 * squared * ln(squared.max(f64::MIN_POSITIVE));
                }
            }
            for (c, sum) in sums.iter_mut().enumerate() {
                let mut total = *sum;
                for (phi, weight) in kept.iter().zip(weights[c..].iter().step_by(self.columns)) {
                    for i in 0..TILE {
                        total[i] += weight * phi[i];
                    }
                }
                *sum = total;
            }
        }
    }

    #[inline(always)]
    fn add_slopes(&self, tile: &Tile, sums: &mut [[f64; TILE]]) {
        let (kernels, affine) = self.weights.split_at(self.weights.len() - 3 * self.columns);
        for (c, pair) in sums.chunks_exact_mut(2).enumerate() {
            pair[0] = [affine[c]; TILE];
            pair[1] = [affine[self.columns + c]; TILE];
        }
        let (mut along, mut up) = ([0.0; TILE], [0.0; TILE]);
        for (centre, weights) in self.centres.as_chunks().0.iter().zip(kernels.chunks_exact(self.columns)) {
            for i in 0..TILE {
                let radial = 1.0 + ln(tile.squared_distance(i, centre).max(f64::MIN_POSITIVE));
                along[i] = radial * (tile.x[i] - centre[0]);
                up[i] = radial * (tile.y[i] - centre[1]);
            }
            for (pair, weight) in sums.chunks_exact_mut(2).zip(weights) {
                for i in 0..TILE {
                    pair[0][i] += weight * along[i];
                    pair[1][i] += weight * up[i];
                }
            }
        }
    }
}

/// The sums over one tile, with the vectors of this processor.
struct Add<'a, const SLOPES: bool> {
    splines: &'a Splines<'a>,
    tile: Tile,
    sums: &'a mut [[f64; TILE]],
}

impl<const SLOPES: bool> WithSimd for Add<'_, SLOPES> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        if SLOPES {
            self.splines.add_slopes(&self.tile, self.sums);
        } else {
            self.splines.add_values(&self.tile, self.sums);
        }
    }
}

/// Coordinates of points; the last tile is filled up with the origin.
struct Tile {
    x: [f64; TILE],
    y: [f64; TILE],
}

impl Tile {
    fn of(points: &[f64]) -> Self {
        let mut tile = Self { x: [0.0; TILE], y: [0.0; TILE] };
        for (i, point) in points.chunks_exact(2).enumerate() {
            (tile.x[i], tile.y[i]) = (point[0], point[1]);
        }
        tile
    }

    #[inline(always)]
    fn squared_distance(&self, i: usize, centre: &[f64; 2]) -> f64 {
        let (x, y) = (self.x[i] - centre[0], self.y[i] - centre[1]);
        x * x + y * y
    }
}

/// Bits of 1/sqrt(2): what is divided by a power of two to be from there to sqrt(2).
const ROOT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;
const ONE: u64 = 0x3ff0_0000_0000_0000;

/// The natural logarithm of a normal number above zero, to one unit in the last place.
///
/// With x = 2^k (1 + f) and s = f / (2 + f), log(1 + f) = 2 atanh(s) = f - f^2/2 + s (f^2/2 + R(s^2)), R by the polynomial
/// of FDLIBM's `log`.
#[inline(always)]
fn ln(x: f64) -> f64 {
    let bits = x.to_bits();
    let exponent = (bits + (ONE - ROOT_HALF)) >> 52;
    // An exponent in the lowest bits of 2^52 becomes a number by subtraction: vectors have no conversion.
    let k = f64::from_bits(exponent | 0x4330_0000_0000_0000) - (4_503_599_627_370_496.0 + 1023.0);
    let f = f64::from_bits(bits.wrapping_sub(exponent << 52).wrapping_add(ONE)) - 1.0;
    let s = f / (2.0 + f);
    let z = s * s;
    let w = z * z;
    let even = w * (0.399_999_999_994_094_2 + w * (0.222_221_984_321_497_84 + w * 0.153_138_376_992_093_73));
    let odd = z
        * (0.666_666_666_666_673_5
            + w * (0.285_714_287_436_623_9 + w * (0.181_835_721_616_180_5 + w * 0.147_981_986_051_165_86)));
    let half = 0.5 * f * f;
    k * 6.931_471_803_691_238e-1
        - ((half - (s * (half + (even + odd)) + k * 1.908_214_929_270_587_7e-10)) - f)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    #[test]
    fn the_logarithm_is_that_of_the_library() {
        let mut x = f64::MIN_POSITIVE;
        while x < 1e308 {
            assert!((ln(x) - x.ln()).abs() <= f64::EPSILON * x.ln().abs(), "{x}");
            x *= 1.000_37;
        }
        assert_eq!(ln(1.0), 0.0);
    }

    /// 137 points about nine centres, and two splines.
    fn example() -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let numbers =
            |n: usize, step: f64| (0..n).map(|i| (step * (i + 1) as f64).fract()).collect::<Vec<_>>();
        (numbers(2 * 137, 0.618_034), numbers(2 * 9, 0.754_878), numbers(2 * 12, 0.569_84))
    }

    #[test]
    fn splines_are_their_sums_on_any_number_of_threads() {
        let (points, centres, weights) = example();
        let splines = Splines { centres: &centres, weights: &weights, columns: 2 };
        let flag = AtomicBool::new(false);
        let values = splines.values(&points, &Pool::new(1, &flag)).unwrap();
        assert_eq!(values, splines.values(&points, &Pool::new(3, &flag)).unwrap());
        for (q, row) in points.chunks(2).zip(values.chunks(2)) {
            for (c, value) in row.iter().enumerate() {
                let mut sum = q[0] * weights[18 + c] + q[1] * weights[20 + c] + weights[22 + c];
                for (centre, w) in centres.chunks(2).zip(weights.chunks(2)) {
                    let r = (q[0] - centre[0]).hypot(q[1] - centre[1]);
                    sum += if r > 0.0 { w[c] * r * r * r.ln() } else { 0.0 };
                }
                assert!((value - sum).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn slopes_are_the_limits_of_differences() {
        let (points, centres, weights) = example();
        let splines = Splines { centres: &centres, weights: &weights, columns: 2 };
        let flag = AtomicBool::new(false);
        let pool = Pool::new(2, &flag);
        let slopes = splines.slopes(&points, &pool).unwrap();
        for axis in 0..2 {
            let at = |step: f64| {
                let moved: Vec<f64> = points
                    .iter()
                    .enumerate()
                    .map(|(i, x)| if i % 2 == axis { x + step } else { *x })
                    .collect();
                splines.values(&moved, &pool).unwrap()
            };
            for (i, (high, low)) in at(1e-5).iter().zip(at(-1e-5)).enumerate() {
                assert!((slopes[2 * i + axis] - (high - low) / 2e-5).abs() < 1e-7);
            }
        }
    }

    #[test]
    fn a_point_on_a_centre_and_one_that_is_none() {
        let splines = Splines { centres: &[0.5, 0.5], weights: &[2.0, 0.0, 0.0, 1.0], columns: 1 };
        let flag = AtomicBool::new(false);
        let pool = Pool::new(1, &flag);
        let points = [0.5, 0.5, f64::NAN, 0.0];
        let values = splines.values(&points, &pool).unwrap();
        assert_eq!(values[0], 1.0);
        assert!(values[1].is_nan());
        assert_eq!(splines.slopes(&points[..2], &pool).unwrap(), [0.0, 0.0]);
        assert!(splines.values(&[], &pool).unwrap().is_empty());
        assert!(Splines { columns: 2, ..splines }.values(&points, &pool).is_err());
    }
}
