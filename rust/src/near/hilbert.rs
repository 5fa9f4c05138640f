//! Hilbert's curve: an order of points in which successive ones are near each other.

use crate::error::Error;
use crate::near::neighbours::unit_scale;
use crate::pool::Pool;

/// Steps of subdivision: cells of a 65,536th of the extent.
const BITS: u32 = 16;

/// The points' indices, sorted along a Hilbert curve through their bounding box.
///
/// Points in one, two or three dimensions lie end to end in a slice; points of one cell are in the order of their
/// indices. Fails as [`crate::near::neighbours::within`] does.
///
/// ```
/// use mexpress::{near::hilbert::hilbert_order, pool::Pool};
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// let corners = [0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0];
/// assert_eq!(hilbert_order(&corners, 2, &Pool::new(1, &flag))?, [0, 3, 1, 2]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn hilbert_order(points: &[f64], dimension: usize, pool: &Pool) -> Result<Vec<usize>, Error> {
    if !(1..=3).contains(&dimension) {
        return Err(Error::Dimension { given: dimension });
    }
    let scale = unit_scale(points.iter().copied())?;
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for point in points.chunks_exact(dimension) {
        for (axis, x) in point.iter().enumerate() {
            (low[axis], high[axis]) = (low[axis].min(x * scale), high[axis].max(x * scale));
        }
    }
    let extent = (0..dimension).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
    let cells = f64::from((1u32 << BITS) - 1) / if extent > 0.0 { extent } else { 1.0 };
    let key = |point: &[f64]| {
        let cell = |axis: usize| ((point[axis] * scale - low[axis]) * cells) as u32;
        let mut cells = [0; 3];
        (0..dimension).for_each(|axis| cells[axis] = cell(axis));
        position(&mut cells[..dimension])
    };
    let count = points.len() / dimension;
    let mut keyed: Vec<(u64, usize)> = (0..count).map(|i| (0, i)).collect();
    let part = count.div_ceil(pool.threads()).max(1);
    let parts = keyed.chunks_mut(part).zip(points.chunks(part * dimension));
    pool.run(
        parts,
        || (),
        |(), (keyed, points)| {
            for ((to, _), point) in keyed.iter_mut().zip(points.chunks_exact(dimension)) {
                *to = key(point);
            }
            keyed.sort_unstable();
        },
    )?;
    // It merges the parts, which it finds sorted.
    keyed.sort();
    Ok(keyed.into_iter().map(|(_, i)| i).collect())
}

/// Place of a cell on the curve: J. Skilling, "Programming the Hilbert curve", AIP Conference Proceedings 707 (2004).
fn position(cell: &mut [u32]) -> u64 {
    let n = cell.len();
    for level in (1..BITS).rev() {
        let below = (1 << level) - 1;
        for axis in 0..n {
            if cell[axis] >> level & 1 == 1 {
                cell[0] ^= below;
            } else {
                let swap = (cell[0] ^ cell[axis]) & below;
                cell[0] ^= swap;
                cell[axis] ^= swap;
            }
        }
    }
    for axis in 1..n {
        cell[axis] ^= cell[axis - 1];
    }
    let turn = (1..BITS)
        .filter(|level| cell[n - 1] >> level & 1 == 1)
        .fold(0, |turn, level| turn ^ ((1 << level) - 1));
    cell.iter_mut().for_each(|x| *x ^= turn);
    let bit = |level: u32, axis: usize| u64::from(cell[axis] >> level & 1);
    (0..BITS)
        .rev()
        .flat_map(|level| (0..n).map(move |axis| (level, axis)))
        .fold(0, |key, (level, axis)| key << 1 | bit(level, axis))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    #[test]
    fn successive_cells_of_a_grid_touch() {
        for dimension in 1..=3 {
            let side = 8_usize;
            let points: Vec<f64> = (0..side.pow(dimension as u32))
                .flat_map(|i| (0..dimension).map(move |axis| (i / side.pow(axis as u32) % side) as f64))
                .collect();
            let flag = AtomicBool::new(false);
            let [order, shared] =
                [1, 3].map(|t| hilbert_order(&points, dimension, &Pool::new(t, &flag)).unwrap());
            assert_eq!(order, shared);
            let place = |i: usize| &points[i * dimension..(i + 1) * dimension];
            for pair in order.windows(2) {
                let steps: f64 = place(pair[0]).iter().zip(place(pair[1])).map(|(a, b)| (a - b).abs()).sum();
                assert_eq!(steps, 1.0);
            }
        }
    }
}
