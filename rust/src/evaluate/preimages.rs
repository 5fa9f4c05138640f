//! Which point a piecewise affine map, or a quotient of such, maps to a given one.
//!
//! Over a triangle with source corners s_k, the map is `sum_k l_k P_k / sum_k l_k w_k` in the barycentric coordinates l of the
//! point. Its image is the triangle of `p_k = P_k / w_k`, where barycentric coordinates are proportional to l_k w_k, so that
//! `s = sum_k (m_k / w_k) s_k / sum_k (m_k / w_k)` is the only point of the triangle that maps to `sum_k m_k p_k`.

use crate::error::Error;
use crate::evaluate::cells::range;
use crate::evaluate::triangles::Triangles;
use crate::pool::Pool;

/// Points of a task.
const TASK: usize = 4096;

/// Two solutions are one if they are nearer than this to each other, in the size of the source: a point on an edge has two.
const SAME: f64 = 1e-9;

/// A corner of a map: where it is, both numerators, and the denominator.
pub type Corner = [f64; 5];

/// The points of the triangles that are mapped to given positions: NaN where there is none, or more than one.
///
/// What has a denominator of at most `least`, which is above zero, is left out.
///
/// ```
/// use mexpress::evaluate::preimages::preimages;
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// let road = [[0.0, 0.0, 0.0, 0.0, 1.0], [4.0, 0.0, 4.0, 0.0, 1.0], [0.0, 4.0, 0.0, 4.0, 3.0]];
/// let found = preimages(&[0.0, 1.0, 9.0, 9.0], &[road], 0.1, &mexpress::pool::Pool::new(1, &flag))?;
/// assert!(found[0] == 0.0 && (found[1] - 2.0).abs() < 1e-14); // (0, 2) / (1 + 2 / 2)
/// assert!(found[2].is_nan());
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn preimages(
    positions: &[f64],
    triangles: &[[Corner; 3]],
    least: f64,
    pool: &Pool<'_>,
) -> Result<Vec<f64>, Error> {
    let positions: &[[f64; 2]] = positions.as_chunks().0;
    let visible: Vec<_> = triangles.iter().flat_map(|triangle| before(triangle, least)).collect();
    let images: Vec<_> =
        visible.iter().map(|corners| corners.map(|[_, _, x, y, w]| [x / w, y / w])).collect();
    let index = Triangles::new(&images, positions);
    let size = [0, 1].map(|b| {
        let [low, high] = range(triangles.as_flattened().iter().map(|corner| corner[b]));
        high - low
    });
    let same = SAME * size[0].max(size[1]);
    let mut found = vec![f64::NAN; 2 * positions.len()];
    pool.run(
        positions.chunks(TASK).zip(found.chunks_mut(2 * TASK)),
        || (),
        |(), (positions, found)| {
            for (position, found) in positions.iter().zip(found.as_chunks_mut().0) {
                let solutions = index.holding(*position).map(|(t, shares)| source(&visible[t], shares));
                if let Some(point) = sole(solutions, same) {
                    *found = point;
                }
            }
        },
    )?;
    Ok(found)
}

fn sole(mut points: impl Iterator<Item = [f64; 2]>, same: f64) -> Option<[f64; 2]> {
    let first = points.next()?;
    points.all(|point| (point[0] - first[0]).abs().max((point[1] - first[1]).abs()) <= same).then_some(first)
}

fn source(corners: &[Corner; 3], shares: [f64; 3]) -> [f64; 2] {
    let [a, b, c] = *corners;
    let [_, second, third] = [0, 1, 2].map(|k| shares[k] / corners[k][4]);
    let total = shares[0] / a[4] + second + third;
    [0, 1].map(|axis| a[axis] + ((b[axis] - a[axis]) * second + (c[axis] - a[axis]) * third) / total)
}

/// The part of a triangle where denominators are above the least, in triangles.
fn before(triangle: &[Corner; 3], least: f64) -> Vec<[Corner; 3]> {
    let mut outline: Vec<Corner> = Vec::with_capacity(4);
    for (k, corner) in triangle.iter().enumerate() {
        let next = &triangle[(k + 1) % 3];
        if corner[4] > least {
            outline.push(*corner);
        }
        if (corner[4] > least) != (next[4] > least) {
            let share = (least - corner[4]) / (next[4] - corner[4]);
            let mut edge: Corner = std::array::from_fn(|b| corner[b] + share * (next[b] - corner[b]));
            edge[4] = least;
            outline.push(edge);
        }
    }
    (2..outline.len()).map(|k| [outline[0], outline[k - 1], outline[k]]).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    #[test]
    fn a_fold_has_two_solutions_and_an_edge_one() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(1, &flag);
        let corner = |x: f64, y: f64, to: [f64; 2]| [x, y, to[0], to[1], 1.0];
        let first =
            [corner(0.0, 0.0, [0.0, 0.0]), corner(1.0, 0.0, [1.0, 0.0]), corner(0.0, 1.0, [0.0, 1.0])];
        let flat = [corner(1.0, 1.0, [1.0, 1.0]), corner(0.0, 1.0, [0.0, 1.0]), corner(1.0, 0.0, [1.0, 0.0])];
        let folded =
            [corner(1.0, 1.0, [0.1, 0.1]), corner(0.0, 1.0, [0.0, 1.0]), corner(1.0, 0.0, [1.0, 0.0])];
        let positions = [0.5, 0.5, 0.3, 0.3, 0.01, 0.01];
        assert_eq!(preimages(&positions, &[first, flat], 0.5, &pool).unwrap(), positions);
        let found = preimages(&positions, &[first, folded], 0.5, &pool).unwrap();
        assert_eq!(found[..2], [0.5, 0.5]);
        assert!(found[2].is_nan() && found[3].is_nan());
        assert_eq!(found[4..], [0.01, 0.01]);
        assert!(preimages(&[], &[first], 0.5, &pool).unwrap().is_empty());
        assert!(preimages(&positions, &[], 0.5, &pool).unwrap().iter().all(|x| x.is_nan()));
    }

    #[test]
    fn what_is_behind_has_no_image() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(1, &flag);
        // x / (1 - y), 1 / (1 - y): the horizon is y = 1.
        let corner = |x: f64, y: f64| [x, y, x, 1.0, 1.0 - y];
        let triangle = [corner(-2.0, 0.0), corner(2.0, 0.0), corner(0.0, 2.0)];
        let back = |point: [f64; 2], least: f64| {
            let position = [point[0] / (1.0 - point[1]), 1.0 / (1.0 - point[1])];
            preimages(&position, &[triangle], least, &pool).unwrap()
        };
        for point in [[0.0, 0.5], [0.4, 0.9], [-1.0, 0.2], [0.3, 0.1]] {
            let found = back(point, 0.05);
            assert!((found[0] - point[0]).hypot(found[1] - point[1]) < 1e-13);
        }
        assert!(back([0.0, 0.96], 0.05)[0].is_nan());
        assert!(back([0.0, 1.5], 0.05)[0].is_nan());
    }
}
