//! Radius and k-nearest queries, exact on gridded and on repeated points.
//!
//! Points in one, two or three dimensions lie end to end in a slice. Distances are compared as squares,
//! summed coordinate by coordinate, after a power of two has brought the points to unit size: that changes no
//! comparison, except that coordinates of any finite magnitude neither overflow nor vanish.

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::error::Error;
use crate::near::tree::{LEAF, LEAVES_A_TASK, Nearest, Tree, Within};
use crate::pool::{Pool, take};
use crate::sets::{MOST_MEMBERS, Sets};

/// For every point, the points within `radius` of it, itself included, sorted by index.
///
/// A negative or undefined radius counts as zero. Fails if the coordinates do not divide into points, if
/// there are not one to three of them per point, or, naming the first of them, if some are not finite.
///
/// ```
/// use mexpress::{near::neighbours::within, pool::Pool};
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// let sets = within(&[0.0, 3.0, 1.0, 1.5], 1, 1.0, &Pool::new(1, &flag))?;
/// assert_eq!(sets.get(0), &[0, 2]);
/// assert_eq!(sets.get(2), &[0, 2, 3]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn within(points: &[f64], dimension: usize, radius: f64, pool: &Pool) -> Result<Sets<'static>, Error> {
    let scale = checked_scale(points, dimension)?;
    let radius = radius.max(0.0) * scale;
    match dimension {
        1 | 2 => all_within::<2>(&scaled(points, dimension, scale), radius * radius, pool),
        _ => all_within::<3>(&scaled(points, dimension, scale), radius * radius, pool),
    }
}

/// For every point, itself and its `k - 1` nearest others, sorted by index.
///
/// Of points at the same distance those with smaller indices are taken, but a point always belongs to its own
/// set, however many coincide with it. Fails as [`within`] does, and if `k` is zero or above the number of
/// points.
///
/// ```
/// use mexpress::{near::neighbours::nearest, pool::Pool};
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// let corners = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0];
/// let sets = nearest(&corners, 2, 2, &Pool::new(1, &flag))?;
/// assert_eq!(sets.get(3), &[1, 3]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn nearest(points: &[f64], dimension: usize, k: usize, pool: &Pool) -> Result<Sets<'static>, Error> {
    let scale = checked_scale(points, dimension)?;
    let n = points.len() / dimension;
    if k == 0 {
        return Err(Error::Length { expected: 1, given: 0 });
    }
    if k > n {
        return Err(Error::Index { index: k, bound: n + 1 });
    }
    let sizes = vec![k; n];
    match dimension {
        1 | 2 => all_nearest(&Tree::<2>::new(&scaled(points, dimension, scale), pool)?, &sizes, pool),
        _ => all_nearest(&Tree::<3>::new(&scaled(points, dimension, scale), pool)?, &sizes, pool),
    }
}

fn checked_scale(points: &[f64], dimension: usize) -> Result<f64, Error> {
    if !(1..=3).contains(&dimension) {
        return Err(Error::Dimension { given: dimension });
    }
    let whole = points.len() - points.len() % dimension;
    if whole != points.len() {
        return Err(Error::Length { expected: whole, given: points.len() });
    }
    unit_scale(points.iter().copied())
}

/// The power of two that brings the largest magnitude near one; an error if a value is not finite.
pub(crate) fn unit_scale(values: impl Iterator<Item = f64>) -> Result<f64, Error> {
    let mut largest = 0.0_f64;
    for (index, value) in values.enumerate() {
        if !value.is_finite() {
            return Err(Error::NotFinite { index });
        }
        largest = largest.max(value.abs());
    }
    if largest == 0.0 {
        return Ok(1.0);
    }
    // The reciprocal of an extreme power of two, or of a subnormal one, is not a normal number.
    let exponent = (largest.to_bits() >> 52).clamp(1, 2045);
    Ok(f64::from_bits((2046 - exponent) << 52))
}

/// The points as arrays; missing coordinates are zero.
pub(crate) fn scaled<const N: usize>(points: &[f64], dimension: usize, scale: f64) -> Vec<[f64; N]> {
    let lift = |point: &[f64]| std::array::from_fn(|axis| point.get(axis).map_or(0.0, |value| value * scale));
    points.chunks_exact(dimension).map(lift).collect()
}

fn all_within<const N: usize>(points: &[[f64; N]], square: f64, pool: &Pool) -> Result<Sets<'static>, Error> {
    let tree = Tree::new(points, pool)?;
    let total = AtomicUsize::new(0);
    // In the order of the tree's leaves, whose points share a search.
    let mut counts = vec![0; points.len()];
    pool.run(
        counts.chunks_mut(LEAVES_A_TASK * LEAF).enumerate(),
        || Within::new(&tree, square),
        |search, (task, counts)| {
            for (leaf, counts) in counts.chunks_mut(LEAF).enumerate() {
                if total.load(Ordering::Relaxed) > MOST_MEMBERS {
                    return;
                }
                for (count, entry) in counts.iter_mut().zip(search.turn_to_leaf(task * LEAVES_A_TASK + leaf))
                {
                    *count = search.count(&entry.point);
                }
                total.fetch_add(counts.iter().sum(), Ordering::Relaxed);
            }
        },
    )?;
    if total.into_inner() > MOST_MEMBERS {
        return Err(Error::TooMany { most: MOST_MEMBERS });
    }
    let mut sizes = vec![0; points.len()];
    for (entry, count) in tree.entries.iter().zip(counts) {
        sizes[entry.index] = count;
    }
    let workspace = || Within::new(&tree, square);
    filled(&tree, &sizes, pool, workspace, |search, leaf, rows| {
        for (entry, row) in search.turn_to_leaf(leaf).iter().zip(rows) {
            search.fill(&entry.point, row);
        }
    })
}

/// Sets of known sizes, each sorted, filled in place by a function of a leaf and of the rows of its entries.
fn filled<const N: usize, W>(
    tree: &Tree<N>,
    sizes: &[usize],
    pool: &Pool,
    workspace: impl Fn() -> W + Sync,
    fill: impl Fn(&mut W, usize, &mut [&mut [usize]]) + Sync,
) -> Result<Sets<'static>, Error> {
    let mut offsets = vec![0; sizes.len() + 1];
    for (i, size) in sizes.iter().enumerate() {
        offsets[i + 1] = offsets[i] + size;
    }
    let mut items = vec![0; offsets[sizes.len()]];
    let mut rest = &mut items[..];
    let mut by_index: Vec<&mut [usize]> = Vec::with_capacity(sizes.len());
    for &size in sizes {
        by_index.push(take(&mut rest, size));
    }
    let mut rows: Vec<&mut [usize]> =
        tree.entries.iter().map(|entry| std::mem::take(&mut by_index[entry.index])).collect();
    pool.run(rows.chunks_mut(LEAVES_A_TASK * LEAF).enumerate(), workspace, |scratch, (task, rows)| {
        for (leaf, rows) in rows.chunks_mut(LEAF).enumerate() {
            fill(scratch, task * LEAVES_A_TASK + leaf, rows);
            rows.iter_mut().for_each(|row| row.sort_unstable());
        }
    })?;
    Ok((offsets, items).into())
}

/// Neighbourhoods that are found when they are asked for: those of many points need more memory than there is.
///
/// ```
/// use mexpress::{near::neighbours::LazyNeighbourhoods, pool::Pool};
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// let lazy = LazyNeighbourhoods::within(&[0.0, 3.0, 1.0, 1.5], 1, 1.0, &Pool::new(1, &flag))?;
/// let mut members = Vec::new();
/// lazy.members(2, &mut members);
/// members.sort();
/// assert_eq!(members, [0, 2, 3]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub struct LazyNeighbourhoods {
    index: Index,
    /// Each centre alone.
    pub singletons: Sets<'static>,
    /// About how many members a neighbourhood has.
    pub mean: f64,
}

enum Index {
    Plane(Balls<2>),
    Space(Balls<3>),
}

struct Balls<const N: usize> {
    points: Vec<[f64; N]>,
    tree: Tree<N>,
    reach: Reach,
}

#[derive(Clone, Copy)]
enum Reach {
    /// The square of a radius.
    Within(f64),
    /// A number of points.
    Nearest(usize),
}

impl LazyNeighbourhoods {
    /// Neighbourhoods of all points within a radius, as [`within`] lists them.
    pub fn within(points: &[f64], dimension: usize, radius: f64, pool: &Pool) -> Result<Self, Error> {
        let scale = checked_scale(points, dimension)?;
        Self::new(points, dimension, scale, Reach::Within((radius.max(0.0) * scale).powi(2)), pool)
    }

    /// Neighbourhoods of the `k` nearest points, as [`nearest`] lists them.
    pub fn nearest(points: &[f64], dimension: usize, k: usize, pool: &Pool) -> Result<Self, Error> {
        let scale = checked_scale(points, dimension)?;
        let count = points.len() / dimension;
        if k == 0 || k > count {
            return Err(Error::Index { index: k, bound: count + 1 });
        }
        Self::new(points, dimension, scale, Reach::Nearest(k), pool)
    }

    fn new(points: &[f64], dimension: usize, scale: f64, reach: Reach, pool: &Pool) -> Result<Self, Error> {
        const SAMPLES: usize = 64;
        let index = match dimension {
            1 | 2 => Index::Plane(Balls::new(scaled(points, dimension, scale), reach, pool)?),
            _ => Index::Space(Balls::new(scaled(points, dimension, scale), reach, pool)?),
        };
        let count = points.len() / dimension;
        let singletons = ((0..=count).collect(), (0..count).collect()).into();
        let mut lazy = Self { index, singletons, mean: 0.0 };
        let mut members = Vec::new();
        let sampled: Vec<usize> = (0..count).step_by(count.div_ceil(SAMPLES).max(1)).collect();
        for &i in &sampled {
            pool.proceed()?;
            lazy.members(i, &mut members);
            lazy.mean += members.len() as f64 / sampled.len() as f64;
        }
        Ok(lazy)
    }

    /// The neighbourhoods of some centres as a list, each sorted by index.
    pub fn list(&self, centres: &[usize], pool: &Pool) -> Result<Sets<'static>, Error> {
        let bound = self.singletons.len();
        if let Some(&index) = centres.iter().find(|&&k| k >= bound) {
            return Err(Error::Index { index, bound });
        }
        let mut lists = vec![Vec::new(); centres.len()];
        let tasks = centres.chunks(LEAF).zip(lists.chunks_mut(LEAF));
        pool.run(
            tasks,
            || (),
            |(), (centres, lists)| {
                for (&k, list) in centres.iter().zip(lists) {
                    self.members(k, list);
                    list.sort_unstable();
                }
            },
        )?;
        Ok(lists.into_iter().collect())
    }

    /// Those of some points alone, in the order of this list.
    pub fn around(mut self, centres: &[usize]) -> Result<Self, Error> {
        let bound = self.singletons.len();
        if let Some(&index) = centres.iter().find(|&&i| i >= bound) {
            return Err(Error::Index { index, bound });
        }
        self.singletons = ((0..=centres.len()).collect(), centres.to_vec()).into();
        Ok(self)
    }

    /// Replaces `out` by the neighbourhood of centre `k`, in no order.
    pub fn members(&self, k: usize, out: &mut Vec<usize>) {
        let i = self.singletons.items[k];
        match &self.index {
            Index::Plane(balls) => balls.members(i, out),
            Index::Space(balls) => balls.members(i, out),
        }
    }
}

impl<const N: usize> Balls<N> {
    fn new(points: Vec<[f64; N]>, reach: Reach, pool: &Pool) -> Result<Self, Error> {
        Ok(Self { tree: Tree::new(&points, pool)?, points, reach })
    }

    fn members(&self, i: usize, out: &mut Vec<usize>) {
        match self.reach {
            Reach::Within(square) => Within::new(&self.tree, square).list(&self.points[i], out),
            Reach::Nearest(k) => {
                out.resize(k, 0);
                Nearest::new(&self.tree).fill(i, &self.points[i], out);
            }
        }
    }
}

/// For every point as many of the nearest as asked for, itself counted, sorted by index.
pub(crate) fn all_nearest<const N: usize>(
    tree: &Tree<N>,
    sizes: &[usize],
    pool: &Pool,
) -> Result<Sets<'static>, Error> {
    if sizes.iter().fold(0, |total: usize, &k| total.saturating_add(k)) > MOST_MEMBERS {
        return Err(Error::TooMany { most: MOST_MEMBERS });
    }
    filled(
        tree,
        sizes,
        pool,
        || Nearest::new(tree),
        |search, leaf, rows| {
            for (entry, row) in tree.leaf(leaf).iter().zip(rows) {
                search.fill(entry.index, &entry.point, row);
            }
        },
    )
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use proptest::prelude::*;

    use super::*;

    static FLAG: AtomicBool = AtomicBool::new(false);

    fn pool(threads: usize) -> Pool<'static> {
        Pool::new(threads, &FLAG)
    }

    fn square(points: &[f64], dimension: usize, i: usize, j: usize) -> f64 {
        let difference = |axis| points[i * dimension + axis] - points[j * dimension + axis];
        (0..dimension).fold(0.0, |sum, axis| sum + difference(axis) * difference(axis))
    }

    fn oracle_within(points: &[f64], dimension: usize, radius: f64) -> Sets<'static> {
        let n = points.len() / dimension;
        let near = |i| (0..n).filter(move |&j| square(points, dimension, i, j) <= radius * radius).collect();
        (0..n).map(near).collect()
    }

    fn oracle_nearest(points: &[f64], dimension: usize, k: usize) -> Sets<'static> {
        let n = points.len() / dimension;
        let near = |i| {
            let mut order: Vec<usize> = (0..n).collect();
            order.sort_by(|&a, &b| {
                let (da, db) = (square(points, dimension, i, a), square(points, dimension, i, b));
                (a != i, da, a).partial_cmp(&(b != i, db, b)).unwrap()
            });
            order.truncate(k);
            order.sort();
            order
        };
        (0..n).map(near).collect()
    }

    #[test]
    fn some_neighbourhoods_are_those_of_all() {
        let points: Vec<f64> = (0..80).map(|k| f64::from(k * k % 37)).collect();
        let centres = [7, 0, 39, 7];
        let all = [within(&points, 2, 5.0, &pool(1)).unwrap(), nearest(&points, 2, 4, &pool(1)).unwrap()];
        let lazy = [
            LazyNeighbourhoods::within(&points, 2, 5.0, &pool(1)).unwrap(),
            LazyNeighbourhoods::nearest(&points, 2, 4, &pool(1)).unwrap(),
        ];
        for (all, lazy) in all.into_iter().zip(lazy) {
            let expected: Sets = centres.iter().map(|&i| all.get(i).to_vec()).collect();
            assert_eq!(lazy.list(&centres, &pool(2)).unwrap(), expected);
            assert_eq!(lazy.list(&[40], &pool(1)), Err(Error::Index { index: 40, bound: 40 }));
            let some = lazy.around(&centres).unwrap();
            assert_eq!(some.singletons.items[..], centres);
            assert_eq!(some.list(&[0, 1, 2, 3], &pool(1)).unwrap(), expected);
            assert!(some.around(&[4]).is_err());
        }
    }

    /// Random, gridded, or nearly all equal, in any supported dimension, at any magnitude.
    fn clouds() -> impl Strategy<Value = (usize, Vec<f64>)> {
        let cells = prop_oneof![Just(2), Just(6), Just(1_i64 << 40)];
        let exponent = prop_oneof![Just(0), -100..100];
        (1_usize..4, 0_usize..90, cells, exponent).prop_flat_map(|(dimension, n, cells, exponent)| {
            let coordinate = (-cells..cells).prop_map(move |c| c as f64 * 2_f64.powi(exponent));
            (Just(dimension), prop::collection::vec(coordinate, n * dimension))
        })
    }

    proptest! {
        #[test]
        fn radius_queries_agree_with_all_pairs((dimension, points) in clouds(), share in 0.0..1.5) {
            let size = points.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            // Powers of two, too, so that grid distances hit the radius exactly.
            for radius in [0.0, share * size, size, size / 2.0] {
                let sets = within(&points, dimension, radius, &pool(1)).unwrap();
                prop_assert_eq!(sets, oracle_within(&points, dimension, radius));
            }
        }

        #[test]
        fn nearest_agree_with_all_pairs((dimension, points) in clouds(), share in 0.0..1.0) {
            let n = points.len() / dimension;
            for k in [1, 2, (share * n as f64) as usize, n] {
                if (1..=n).contains(&k) {
                    let sets = nearest(&points, dimension, k, &pool(1)).unwrap();
                    prop_assert_eq!(sets, oracle_nearest(&points, dimension, k));
                }
            }
        }
    }

    fn grid(side: usize) -> Vec<f64> {
        (0..side * side).flat_map(|i| [(i % side) as f64 * 0.1, (i / side) as f64 * 0.1]).collect()
    }

    #[test]
    fn threads_do_not_matter() {
        let points = grid(40);
        for threads in [2, 3] {
            let [one, many] = [1, threads].map(|t| within(&points, 2, 0.3, &pool(t)).unwrap());
            assert_eq!(one, many);
            let [one, many] = [1, threads].map(|t| nearest(&points, 2, 7, &pool(t)).unwrap());
            assert_eq!(one, many);
        }
        assert_eq!(nearest(&points, 2, 7, &pool(2)).unwrap(), oracle_nearest(&points, 2, 7));
    }

    #[test]
    fn many_equal_points_take_no_longer() {
        let points = [0.5; 40_000];
        let sets = nearest(&points, 2, 5, &pool(1)).unwrap();
        assert_eq!(sets.get(2), &[0, 1, 2, 3, 4]);
        assert_eq!(sets.get(19_999), &[0, 1, 2, 3, 19_999]);
    }

    #[test]
    fn extreme_magnitudes_neither_overflow_nor_vanish() {
        for size in [f64::MAX, 1e300, 1e-300, 5e-324] {
            let points = [0.0, size, -size];
            let sets = within(&points, 1, size, &pool(1)).unwrap();
            assert_eq!(sets.get(1), &[0, 1], "{size}");
            assert_eq!(nearest(&points, 1, 2, &pool(1)).unwrap().get(2), &[0, 2], "{size}");
        }
    }

    #[test]
    fn no_points_and_odd_radii() {
        assert!(within(&[], 2, 1.0, &pool(2)).unwrap().is_empty());
        for radius in [-1.0, f64::NAN] {
            let sets = within(&[0.0, 1.0, 0.0], 1, radius, &pool(1)).unwrap();
            assert_eq!(sets.get(0), &[0, 2]);
        }
        assert_eq!(within(&[0.0, 9.0], 1, f64::INFINITY, &pool(1)).unwrap().get(0), &[0, 1]);
    }

    #[test]
    fn unusable_arguments_are_named() {
        let points = [0.0, 1.0, 2.0, 3.0];
        for dimension in [0, 4, usize::MAX] {
            assert_eq!(within(&points, dimension, 1.0, &pool(1)), Err(Error::Dimension { given: dimension }));
        }
        assert_eq!(nearest(&points, 3, 1, &pool(1)), Err(Error::Length { expected: 3, given: 4 }));
        assert_eq!(nearest(&points, 2, 3, &pool(1)), Err(Error::Index { index: 3, bound: 3 }));
        assert_eq!(nearest(&points, 2, 0, &pool(1)), Err(Error::Length { expected: 1, given: 0 }));
        assert_eq!(within(&[0.0, f64::NAN], 1, 1.0, &pool(1)), Err(Error::NotFinite { index: 1 }));
    }
}
