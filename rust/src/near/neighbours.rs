//! Radius and k-nearest queries, exact on gridded and on repeated points.
//!
//! Points in one, two or three dimensions lie end to end in a slice. Distances are compared as squares,
//! summed coordinate by coordinate, after a power of two has brought the points to unit size: that changes no
//! comparison, except that coordinates of any finite magnitude neither overflow nor vanish.

use std::sync::atomic::{AtomicUsize, Ordering};

use rstar::primitives::GeomWithData;
use rstar::{ParentNode, Point, PointDistance, RTree, RTreeNode};

use crate::error::Error;
use crate::pool::Pool;
use crate::sets::{MOST_MEMBERS, Sets};

/// Points a task looks after: enough to hide the queue, few enough to balance crowded and sparse regions.
const CHUNK: usize = 256;

/// Candidates listed before the nearest are told from the others, as a multiple of how many are wanted.
const CANDIDATES: usize = 2;

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
pub fn within(points: &[f64], dimension: usize, radius: f64, pool: &Pool) -> Result<Sets, Error> {
    let scale = checked_scale(points, dimension)?;
    let radius = radius.max(0.0) * scale;
    match dimension {
        1 | 2 => all_within::<2>(&scaled(points, dimension, scale), radius * radius, pool),
        _ => all_within::<3>(&scaled(points, dimension, scale), radius * radius, pool),
    }
}

/// For every point, itself and its `k - 1` nearest others, sorted by index.
///
/// Of points at the same distance those with smaller indices are taken, but a point always belongs to its singletons
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
pub fn nearest(points: &[f64], dimension: usize, k: usize, pool: &Pool) -> Result<Sets, Error> {
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
        1 | 2 => all_nearest::<2>(&scaled(points, dimension, scale), &sizes, pool),
        _ => all_nearest::<3>(&scaled(points, dimension, scale), &sizes, pool),
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

/// The points as arrays; missing coordinates are zero, since the trees want two at least.
pub(crate) fn scaled<const N: usize>(points: &[f64], dimension: usize, scale: f64) -> Vec<[f64; N]> {
    let lift = |point: &[f64]| std::array::from_fn(|axis| point.get(axis).map_or(0.0, |value| value * scale));
    points.chunks_exact(dimension).map(lift).collect()
}

/// The distinct places, and the points at each of them, sorted.
pub(crate) fn places<const N: usize>(points: &[[f64; N]]) -> (Vec<[f64; N]>, Sets) {
    let mut items: Vec<usize> = (0..points.len()).collect();
    items.sort_unstable_by(|&i, &j| {
        let by_place = points[i].partial_cmp(&points[j]).unwrap_or(std::cmp::Ordering::Equal);
        by_place.then(i.cmp(&j))
    });
    let (mut distinct, mut offsets) = (Vec::new(), vec![0]);
    for group in items.chunk_by(|&i, &j| points[i] == points[j]) {
        distinct.push(points[group[0]]);
        offsets.push(offsets[distinct.len() - 1] + group.len());
    }
    (distinct, Sets { offsets, items })
}

pub(crate) type Place<const N: usize> = GeomWithData<[f64; N], usize>;
pub(crate) type Tree<const N: usize> = RTree<Place<N>>;

pub(crate) fn tree<const N: usize>(points: &[[f64; N]]) -> Tree<N>
where
    [f64; N]: Point<Scalar = f64>,
{
    let numbered = points.iter().enumerate().map(|(i, &point)| GeomWithData::new(point, i));
    RTree::bulk_load(numbered.collect())
}

fn all_within<const N: usize>(points: &[[f64; N]], square: f64, pool: &Pool) -> Result<Sets, Error>
where
    [f64; N]: Point<Scalar = f64>,
{
    let tree = tree(points);
    let mut chunks = vec![Sets { offsets: vec![0], items: Vec::new() }; points.len().div_ceil(CHUNK)];
    let total = AtomicUsize::new(0);
    let search = |(): &mut (), (sets, chunk): (&mut Sets, &[[f64; N]])| {
        for &point in chunk {
            if total.load(Ordering::Relaxed) > MOST_MEMBERS {
                return;
            }
            let start = sets.items.len();
            sets.items.extend(tree.locate_within_distance(point, square).map(|found| found.data));
            sets.items[start..].sort_unstable();
            sets.offsets.push(sets.items.len());
            total.fetch_add(sets.items.len() - start, Ordering::Relaxed);
        }
    };
    pool.run(chunks.iter_mut().zip(points.chunks(CHUNK)), || (), search)?;
    if total.into_inner() > MOST_MEMBERS {
        return Err(Error::TooMany { most: MOST_MEMBERS });
    }
    joined(chunks, pool)
}

/// Neighbourhoods that are found when they are asked for: those of many points need more memory than there is.
///
/// ```
/// use mexpress::near::neighbours::LazyNeighbourhoods;
/// let lazy = LazyNeighbourhoods::within(&[0.0, 3.0, 1.0, 1.5], 1, 1.0)?;
/// let mut members = Vec::new();
/// lazy.members(2, &mut members);
/// members.sort();
/// assert_eq!(members, [0, 2, 3]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub struct LazyNeighbourhoods {
    index: Index,
    /// Each point alone.
    pub singletons: Sets,
    /// About how many members a neighbourhood has.
    pub mean: f64,
}

enum Index {
    Plane(Balls<2>),
    Space(Balls<3>),
}

struct Balls<const N: usize>
where
    [f64; N]: Point<Scalar = f64>,
{
    points: Vec<[f64; N]>,
    tree: Tree<N>,
    reach: Reach,
}

enum Reach {
    /// The square of a radius; the tree is of points.
    Within(f64),
    /// A number of points; the tree is of places, with these members.
    Nearest(usize, Sets),
}

impl LazyNeighbourhoods {
    /// Neighbourhoods of all points within a radius, as [`within`] lists them.
    pub fn within(points: &[f64], dimension: usize, radius: f64) -> Result<Self, Error> {
        let scale = checked_scale(points, dimension)?;
        let square = (radius.max(0.0) * scale).powi(2);
        let index = match dimension {
            1 | 2 => Index::Plane(Balls::within(scaled(points, dimension, scale), square)),
            _ => Index::Space(Balls::within(scaled(points, dimension, scale), square)),
        };
        Ok(Self::new(index, points.len() / dimension))
    }

    /// Neighbourhoods of the `k` nearest points, as [`nearest`] lists them.
    pub fn nearest(points: &[f64], dimension: usize, k: usize) -> Result<Self, Error> {
        let scale = checked_scale(points, dimension)?;
        let count = points.len() / dimension;
        if k == 0 || k > count {
            return Err(Error::Index { index: k, bound: count + 1 });
        }
        let index = match dimension {
            1 | 2 => Index::Plane(Balls::nearest(scaled(points, dimension, scale), k)),
            _ => Index::Space(Balls::nearest(scaled(points, dimension, scale), k)),
        };
        Ok(Self::new(index, count))
    }

    fn new(index: Index, count: usize) -> Self {
        const SAMPLES: usize = 64;
        let singletons = Sets { offsets: (0..=count).collect(), items: (0..count).collect() };
        let mut lazy = Self { index, singletons, mean: 0.0 };
        let mut members = Vec::new();
        let sampled: Vec<usize> = (0..count).step_by(count.div_ceil(SAMPLES).max(1)).collect();
        for &i in &sampled {
            lazy.members(i, &mut members);
            lazy.mean += members.len() as f64 / sampled.len() as f64;
        }
        lazy
    }

    /// Replaces `out` by the neighbourhood of point `i`, in no order.
    pub fn members(&self, i: usize, out: &mut Vec<usize>) {
        match &self.index {
            Index::Plane(balls) => balls.members(i, out),
            Index::Space(balls) => balls.members(i, out),
        }
    }
}

impl<const N: usize> Balls<N>
where
    [f64; N]: Point<Scalar = f64>,
{
    fn within(points: Vec<[f64; N]>, square: f64) -> Self {
        Self { tree: tree(&points), points, reach: Reach::Within(square) }
    }

    fn nearest(points: Vec<[f64; N]>, k: usize) -> Self {
        let (distinct, members) = places(&points);
        Self { tree: tree(&distinct), points, reach: Reach::Nearest(k, members) }
    }

    fn members(&self, i: usize, out: &mut Vec<usize>) {
        out.clear();
        match &self.reach {
            Reach::Within(square) => {
                out.extend(self.tree.locate_within_distance(self.points[i], *square).map(|found| found.data));
            }
            Reach::Nearest(k, members) => {
                out.resize(*k, 0);
                Search::new(&self.tree, members).nearest(i, &self.points[i], out);
            }
        }
    }
}

fn joined(parts: Vec<Sets>, pool: &Pool) -> Result<Sets, Error> {
    let mut offsets = Vec::with_capacity(1 + parts.iter().map(Sets::len).sum::<usize>());
    let mut items = Vec::with_capacity(parts.iter().map(|part| part.items.len()).sum());
    offsets.push(0);
    for part in parts {
        pool.proceed()?;
        offsets.extend(part.offsets[1..].iter().map(|offset| items.len() + offset));
        items.extend(part.items);
    }
    Ok(Sets { offsets, items })
}

/// For every point as many of the nearest as asked for, itself counted, sorted by index.
pub(crate) fn all_nearest<const N: usize>(
    points: &[[f64; N]],
    sizes: &[usize],
    pool: &Pool,
) -> Result<Sets, Error>
where
    [f64; N]: Point<Scalar = f64>,
{
    // A tree of places, not of points: a query would visit every point that coincides with its singletons.
    let (distinct, members) = places(points);
    let tree = tree(&distinct);
    let total = sizes.iter().fold(0, |total: usize, &k| total.saturating_add(k));
    if total > MOST_MEMBERS {
        return Err(Error::TooMany { most: MOST_MEMBERS });
    }
    let mut items = vec![0; total];
    let mut rest = &mut items[..];
    let mut rows: Vec<Option<&mut [usize]>> = Vec::with_capacity(points.len());
    for &k in sizes {
        let (row, after) = rest.split_at_mut(k);
        rest = after;
        rows.push(Some(row));
    }
    // In the order of places, so that successive searches visit the same part of the tree.
    let mut ordered: Vec<(usize, &mut [usize])> =
        members.items.iter().filter_map(|&i| rows[i].take().map(|row| (i, row))).collect();
    pool.run(
        ordered.chunks_mut(CHUNK),
        || Search::new(&tree, &members),
        |search, chunk| {
            for (i, row) in chunk {
                search.nearest(*i, &points[*i], row);
                row.sort_unstable();
            }
        },
    )?;
    let mut offsets = vec![0];
    offsets.extend(sizes.iter().scan(0, |end, k| {
        *end += k;
        Some(*end)
    }));
    Ok(Sets { offsets, items })
}

/// Depth first, the nearer branches first. The tree's singletons iterator takes twice the time, and keeps all ties.
pub(crate) struct Search<'a, const N: usize>
where
    [f64; N]: Point<Scalar = f64>,
{
    tree: &'a Tree<N>,
    members: &'a Sets,
    k: usize,
    /// Squared distances, as bits (which order numbers that are not negative), and indices.
    found: Vec<(u64, usize)>,
    pending: Vec<(f64, &'a ParentNode<Place<N>>)>,
}

impl<'a, const N: usize> Search<'a, N>
where
    [f64; N]: Point<Scalar = f64>,
{
    /// In a tree of places with these members.
    pub(crate) fn new(tree: &'a Tree<N>, members: &'a Sets) -> Self {
        Self { tree, members, k: 0, found: Vec::new(), pending: Vec::new() }
    }

    /// Fills the row with the nearest of point `i`, itself one of them, in no order.
    pub(crate) fn nearest(&mut self, i: usize, point: &[f64; N], row: &mut [usize]) {
        let k = row.len();
        for (to, &mut (_, j)) in row.iter_mut().zip(self.find(point, k)) {
            *to = j;
        }
        if !row.contains(&i) {
            row[k - 1] = i;
        }
    }

    /// The `k` nearest of a place, as squared distances (bits of them) and indices, in no order.
    pub(crate) fn find(&mut self, point: &[f64; N], k: usize) -> &mut [(u64, usize)] {
        self.k = k;
        self.found.clear();
        self.pending.push((0.0, self.tree.root()));
        let mut bound = f64::INFINITY;
        while let Some((distance, node)) = self.pending.pop() {
            if distance <= bound {
                self.open(node, point, &mut bound);
            }
        }
        self.keep_nearest();
        &mut self.found
    }

    fn open(&mut self, node: &'a ParentNode<Place<N>>, point: &[f64; N], bound: &mut f64) {
        let start = self.pending.len();
        for child in node.children() {
            match child {
                RTreeNode::Parent(parent) => {
                    self.pending.push((parent.envelope().distance_2(point), parent));
                }
                RTreeNode::Leaf(place) => {
                    let distance = place.distance_2(point);
                    if distance <= *bound {
                        let members = self.members.get(place.data).iter().take(self.k);
                        self.found.extend(members.map(|&j| (distance.to_bits(), j)));
                    }
                }
            }
        }
        self.pending[start..].sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        if self.found.len() >= CANDIDATES * self.k {
            *bound = self.keep_nearest();
        }
    }

    /// Drops all but the `k` nearest, the last of which comes last; its squared distance.
    fn keep_nearest(&mut self) -> f64 {
        let (_, &mut (bits, _), _) = self.found.select_nth_unstable(self.k - 1);
        self.found.truncate(self.k);
        f64::from_bits(bits)
    }
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

    fn oracle_within(points: &[f64], dimension: usize, radius: f64) -> Sets {
        let n = points.len() / dimension;
        let near = |i| (0..n).filter(move |&j| square(points, dimension, i, j) <= radius * radius).collect();
        (0..n).map(near).collect()
    }

    fn oracle_nearest(points: &[f64], dimension: usize, k: usize) -> Sets {
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
