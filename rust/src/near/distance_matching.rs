//! Nearest-neighbour distance matching: how many near data to hold out with each datum, so that predictions under
//! cross-validation reach as far as those that the model is used for (Mila, Mateu, Pebesma, Meyer 2022).
//!
//! With n data and N queries let F(r) be the number of queries within r of their nearest datum. The published
//! algorithm visits the data in the order of their distance to the nearest datum that is not yet held out; if so
//! many are at most as far as r that `count - 1 >= n F(r) / N`, the nearest is held out as well, else the datum is
//! done, at r. Put otherwise: of n places the s-th, from zero, opens at the distance of the query number
//! `floor(s N / n)` in order, and a datum is done at the first distance where a place is free. So all that is
//! nearer than the next free place can be held out at once.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::error::Error;
use crate::near::neighbours::{all_nearest, scaled, unit_scale};
use crate::near::tree::{Nearest, Tree};
use crate::pool::Pool;
use crate::sets::Sets;

/// Queries a task looks after.
const CHUNK: usize = 256;

/// Neighbours that the first search for a datum finds; each later one finds twice as many as the one before.
const FIRST: usize = 16;

/// For every point, itself and so many of the nearest others, at most `most`, that the distances to the nearest of the
/// rest are spread as those of `queries` to the points; sorted by index.
///
/// Of points at the same distance those with smaller indices are held out first. Fails as
/// [`nearest`](crate::near::neighbours::nearest) does, and if there are no queries.
///
/// ```
/// use mexpress::{near::distance_matching::matched, pool::Pool};
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// let points = [0.0, 1.0, 2.0, 3.0, 4.0];
/// let sets = matched(&points, &[-2.0, 6.0], 1, 3, &Pool::new(1, &flag))?;
/// assert_eq!(sets.get(0), &[0, 1]);
/// assert_eq!(sets.get(2), &[1, 2, 3]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn matched(
    points: &[f64],
    queries: &[f64],
    dimension: usize,
    most: usize,
    pool: &Pool<'_>,
) -> Result<Sets<'static>, Error> {
    if !(1..=3).contains(&dimension) {
        return Err(Error::Dimension { given: dimension });
    }
    for coordinates in [points, queries] {
        let whole = (coordinates.len() - coordinates.len() % dimension).max(dimension);
        if whole != coordinates.len() {
            return Err(Error::Length { expected: whole, given: coordinates.len() });
        }
    }
    // One scale for both, or their distances could not be compared.
    let scale = unit_scale(points.iter().chain(queries).copied())?;
    match dimension {
        1 | 2 => {
            in_space::<2>(&scaled(points, dimension, scale), &scaled(queries, dimension, scale), most, pool)
        }
        _ => in_space::<3>(&scaled(points, dimension, scale), &scaled(queries, dimension, scale), most, pool),
    }
}

fn in_space<const N: usize>(
    points: &[[f64; N]],
    queries: &[[f64; N]],
    most: usize,
    pool: &Pool<'_>,
) -> Result<Sets<'static>, Error> {
    let tree = Tree::new(points, pool)?;
    let mut wanted = vec![0; queries.len()];
    pool.run(
        wanted.chunks_mut(CHUNK).zip(queries.chunks(CHUNK)),
        || Nearest::new(&tree),
        |search, (wanted, queries)| {
            for (to, query) in wanted.iter_mut().zip(queries) {
                *to = search.find(query, 1)[0].0;
            }
        },
    )?;
    wanted.sort_unstable();
    let open: Vec<u64> = (0..points.len()).map(|s| wanted[s * wanted.len() / points.len()]).collect();
    // Each datum has a distance to be done at: one other is left to it at least.
    let most = most.min(points.len().saturating_sub(2));
    let sizes = match_distances(points, &tree, &open, most, pool)?;
    all_nearest(&tree, &sizes, pool)
}

/// How many of the nearest of each datum are held out, itself counted, given the squared distances (bits of them) at
/// which places open.
fn match_distances<const N: usize>(
    points: &[[f64; N]],
    tree: &Tree<N>,
    open: &[u64],
    most: usize,
    pool: &Pool<'_>,
) -> Result<Vec<usize>, Error> {
    let n = points.len();
    let mut sizes = vec![1; n];
    if most == 0 {
        return Ok(sizes);
    }
    let mut rings = Rings { points, search: Nearest::new(tree), lists: vec![Ring::default(); n] };
    pool.run(
        rings.lists.chunks_mut(CHUNK).zip(points.chunks(CHUNK)),
        || Nearest::new(tree),
        |search, (lists, points)| {
            for (ring, point) in lists.iter_mut().zip(points) {
                ring.find(search, point, 1, n);
            }
        },
    )?;
    let mut queue: BinaryHeap<_> = (0..n).map(|i| Reverse((rings.beyond(i, 1)[0], i))).collect();
    let (mut done, mut free, mut group) = (0, 0, Vec::new());
    while let Some(Reverse((square, first))) = queue.pop() {
        pool.proceed()?;
        group.clear();
        group.push(first);
        while let Some(&Reverse((same, i))) = queue.peek()
            && same == square
        {
            queue.pop();
            group.push(i);
        }
        free += open[free..].iter().take_while(|&&at| at <= square).count();
        for (k, &i) in group.iter().enumerate() {
            if done + group.len() - k > free {
                let passed = |d: u64| d <= square || d < open[done];
                sizes[i] = rings.first(i, sizes[i], most + 1, passed);
                let next = rings.beyond(i, sizes[i])[0];
                if next > square {
                    queue.push(Reverse((next, i)));
                    continue;
                }
            }
            done += 1;
            rings.lists[i] = Default::default();
        }
    }
    Ok(sizes)
}

/// Sorted squared distances from each datum to the others, found as far as they are needed.
struct Rings<'a, const N: usize> {
    points: &'a [[f64; N]],
    search: Nearest<'a, N>,
    lists: Vec<Ring>,
}

/// The distances from one datum that are known: successive ones, the first of which has a rank.
#[derive(Clone, Default)]
struct Ring {
    start: usize,
    squares: Vec<u64>,
}

impl Ring {
    /// Replaces them by those from a rank on, of so many data.
    fn find<const N: usize>(
        &mut self,
        search: &mut Nearest<'_, N>,
        point: &[f64; N],
        rank: usize,
        count: usize,
    ) {
        let found = search.find(point, (2 * rank).max(FIRST).min(count));
        found.sort_unstable();
        self.squares.clear();
        self.squares.extend(found[rank..].iter().map(|&(square, _)| square));
        self.start = rank;
    }
}

impl<const N: usize> Rings<'_, N> {
    /// Those of datum `i` from a rank on, one at least; it is its own nearest, of rank zero.
    fn beyond(&mut self, i: usize, rank: usize) -> &[u64] {
        let ring = &mut self.lists[i];
        if rank >= ring.start + ring.squares.len() {
            ring.find(&mut self.search, &self.points[i], rank, self.points.len());
        }
        &ring.squares[rank - ring.start..]
    }

    /// The first rank, from one to another, that is not passed.
    fn first(&mut self, i: usize, mut rank: usize, last: usize, passed: impl Fn(u64) -> bool) -> usize {
        while rank < last {
            let squares = self.beyond(i, rank);
            let (number, count) = (squares.iter().take_while(|&&d| passed(d)).count(), squares.len());
            rank += number;
            if number < count {
                break;
            }
        }
        rank.min(last)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    static FLAG: AtomicBool = AtomicBool::new(false);

    fn grid(side: usize) -> Vec<f64> {
        (0..side * side).flat_map(|i| [(i % side) as f64, (i / side) as f64]).collect()
    }

    #[test]
    fn threads_do_not_matter() {
        let points: Vec<f64> = grid(30).iter().map(|x| x.powi(2)).collect();
        let queries: Vec<f64> = grid(40).iter().map(|x| 60.0 * x).collect();
        let [one, many] = [1, 3].map(|t| matched(&points, &queries, 2, 700, &Pool::new(t, &FLAG)).unwrap());
        assert!(one.items.len() > 3 * 900);
        assert_eq!(one, many);
    }

    #[test]
    fn one_other_is_left_at_least() {
        for (n, most) in [(1, 5), (2, 5), (3, 5), (9, 100), (9, 3)] {
            let points: Vec<f64> = (0..n).map(f64::from).collect();
            let sets = matched(&points, &[1e6], 1, most, &Pool::new(1, &FLAG)).unwrap();
            let held = 1 + most.min((n as usize).saturating_sub(2));
            assert!((0..sets.len()).all(|i| sets.get(i).len() == held), "{n} {most}");
        }
    }

    #[test]
    fn unusable_arguments_are_named() {
        let run = |points: &[f64], queries: &[f64], d| {
            matched(points, queries, d, 1, &Pool::new(1, &FLAG)).unwrap_err()
        };
        assert_eq!(run(&[0.0, 1.0], &[], 2), Error::Length { expected: 2, given: 0 });
        assert_eq!(run(&[0.0, 1.0, 2.0], &[0.0, 1.0], 2), Error::Length { expected: 2, given: 3 });
        assert_eq!(run(&[0.0], &[0.0], 4), Error::Dimension { given: 4 });
        assert_eq!(run(&[0.0, 1.0], &[f64::NAN, 1.0], 2), Error::NotFinite { index: 2 });
    }
}
