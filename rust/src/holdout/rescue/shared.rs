//! Training rows that neighbouring sets have in common, reduced once: to their triangle each set then adds the rows that it
//! leaves of those which the others hold out.
//!
//! Rows are only ever added, by reflections, so a triangle is as good as one of all training rows at once.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use crate::error::Error;
use crate::fit::linalg;
use crate::pool::Pool;

/// The most sets of a group, each of which is a task.
const MOST_SETS: usize = 32;

/// What adding a row costs beside reducing it with many others, and what each set costs besides, in rows.
const SLOWER: f64 = 2.5;
const COPIES: f64 = 8.0;

/// Columns reflected together: two vectors of the widest kind, whose sums do not wait for each other.
const LANES: usize = 16;

/// Neighbouring sets in a list.
pub(in crate::holdout) struct Group {
    pub sets: Range<usize>,
    /// All data that any of them holds out; none if nothing is to be shared.
    pub union: Vec<usize>,
    /// In rows that are reduced.
    pub cost: f64,
}

/// Groups sets of `data` that have so many rows and columns, so that it pays to reduce the rows once that a group leaves.
pub(in crate::holdout) fn groups(
    sets: &[Vec<usize>],
    data: usize,
    (rows, columns): (usize, usize),
) -> Vec<Group> {
    let (rows, columns) = (rows as f64, columns as f64);
    let each = rows / data.max(1) as f64;
    let whole = |held: usize| (rows - each * held as f64).max(columns) - columns / 3.0;
    let mut of_group = vec![0; data];
    let mut found: Vec<Group> = Vec::new();
    let mut listed = 0;
    for (k, set) in sets.iter().enumerate() {
        let current = found.len();
        let alone = whole(set.len());
        if let Some(group) = found.last_mut().filter(|group| group.sets.len() < MOST_SETS) {
            let before = group.union.len();
            group.union.extend(set.iter().filter(|&&datum| of_group[datum] != current));
            let (count, union) = (k + 1 - group.sets.start, group.union.len());
            let added = each * (count * union - listed - set.len()) as f64;
            let together = whole(union) + SLOWER * added + COPIES * count as f64;
            if together < group.cost + alone {
                group.union[before..].iter().for_each(|&datum| of_group[datum] = current);
                group.sets.end = k + 1;
                (listed, group.cost) = (listed + set.len(), together);
                continue;
            }
            group.union.truncate(before);
        }
        set.iter().for_each(|&datum| of_group[datum] = current + 1);
        found.push(Group { sets: k..k + 1, union: set.clone(), cost: alone });
        listed = set.len();
    }
    found.iter_mut().filter(|group| group.sets.len() == 1).for_each(|group| group.union.clear());
    found
}

/// The triangle of the common rows, and the others.
#[derive(Default)]
pub(super) struct Shared {
    order: usize,
    /// Entries and right-hand sides of a row, padded.
    stride: usize,
    /// The first `order` rows.
    triangle: Vec<f64>,
    others: Vec<usize>,
    entries: Vec<f64>,
    /// Those of one set under way.
    sum: Vec<f64>,
    added: Vec<f64>,
    reflector: Vec<f64>,
}

impl Shared {
    /// Takes the common rows' triangle, of `order` rows, which has so many entries and right-hand sides in a row.
    pub fn start<'a>(&mut self, order: usize, width: usize, column: impl Fn(usize) -> &'a [f64]) {
        self.order = order;
        self.stride = width.next_multiple_of(LANES);
        self.triangle.clear();
        self.triangle.resize(order * self.stride, 0.0);
        for j in 0..width {
            let entries = self.triangle[j..].iter_mut().step_by(self.stride);
            entries.zip(&column(j)[..order.min(j + 1)]).for_each(|(to, r)| *to = *r);
        }
        self.others.clear();
        self.entries.clear();
    }

    pub fn push(&mut self, row: usize, entries: &[f64]) {
        self.others.push(row);
        self.entries.extend_from_slice(entries);
        self.entries.resize(self.others.len() * self.stride, 0.0);
    }

    /// Nothing is shared.
    pub fn clear(&mut self) {
        self.others.clear();
    }

    pub fn is_empty(&self) -> bool {
        self.others.is_empty()
    }

    /// Leaves the triangle of the common rows and of those of the others that are not held out in `out`, whose columns are
    /// `height` apart.
    pub fn reduce(
        &mut self,
        held: &[bool],
        out: &mut [f64],
        height: usize,
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        let Self { order, stride, triangle, others, entries, sum, added, reflector } = self;
        sum.clone_from(triangle);
        added.clear();
        let left = others.iter().zip(entries.chunks_exact(*stride)).filter(|&(&row, _)| !held[row]);
        left.for_each(|(_, entries)| added.extend_from_slice(entries));
        for (j, row) in sum.chunks_exact_mut(*stride).enumerate() {
            pool.proceed()?;
            reflector.clear();
            reflector.extend(added[j.min(added.len())..].iter().step_by(*stride));
            let tau = linalg::householder(&mut row[j], reflector);
            if tau.is_finite() {
                let pivot = row[j];
                Arch::new().dispatch(Reflect { reflector, scale: tau.recip(), row, added, from: j + 1 });
                row[j] = pivot;
            }
        }
        for (j, column) in out.chunks_exact_mut(height).enumerate() {
            let entries = sum[j.min(sum.len())..].iter().step_by(*stride);
            column.iter_mut().zip(entries).take((j + 1).min(*order)).for_each(|(to, r)| *to = *r);
        }
        Ok(())
    }
}

/// Reflects a row of the triangle and all that are added, from a column on; what stands before it counts no more.
struct Reflect<'a> {
    reflector: &'a [f64],
    scale: f64,
    row: &'a mut [f64],
    added: &'a mut [f64],
    from: usize,
}

/// Not a closure, whose code may be compiled apart, for the narrowest vectors.
impl WithSimd for Reflect<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { reflector, scale, row, added, from } = self;
        let stride = row.len();
        for (k, head) in row.as_chunks_mut::<LANES>().0.iter_mut().enumerate().skip(from / LANES) {
            let place = |i: usize| i * stride + k * LANES;
            let mut along = *head;
            for (i, v) in reflector.iter().enumerate() {
                let rest = &added[place(i)..place(i) + LANES];
                along.iter_mut().zip(rest).for_each(|(sum, x)| *sum += v * x);
            }
            along.iter_mut().for_each(|x| *x *= scale);
            head.iter_mut().zip(along).for_each(|(x, along)| *x -= along);
            for (i, v) in reflector.iter().enumerate() {
                let rest = &mut added[place(i)..place(i) + LANES];
                rest.iter_mut().zip(along).for_each(|(x, along)| *x -= v * along);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::linalg::dot;
    use crate::testing::{assert_close, noise, pool};

    /// `R^T R` is the Gram matrix of all rows that are not held out, right-hand sides included, whatever was shared.
    #[test]
    fn a_triangle_is_that_of_all_rows_left() {
        for (order, responses, common, others) in [(1, 1, 4, 2), (7, 2, 9, 5), (8, 1, 20, 30), (21, 3, 2, 40)]
        {
            let width = order + responses;
            let rows = noise((common + others) * width, 3);
            let row = |i: usize| &rows[i * width..(i + 1) * width];
            // Any matrix with the Gram matrix of the common rows will do that is a triangle: theirs, one after another.
            let (mut shared, mut held) = (Shared::default(), vec![false; common + others]);
            let zeros = vec![0.0; width];
            shared.start(order, width, |_| &zeros);
            (0..common).for_each(|i| shared.push(i, row(i)));
            let mut block = vec![0.0; width * (width + 3)];
            shared.reduce(&held, &mut block, width + 3, &pool(1)).unwrap();
            shared.start(order, width, |j| &block[j * (width + 3)..(j + 1) * (width + 3)]);
            (common..common + others).for_each(|i| shared.push(i, row(i)));
            assert!(!shared.is_empty());
            for out in [vec![common], vec![], vec![common, common + 1], (common..common + others).collect()] {
                out.iter().for_each(|&i| held[i] = true);
                shared.reduce(&held, &mut block, width + 3, &pool(1)).unwrap();
                let column = |j: usize| &block[j * (width + 3)..][..order.min(j + 1)];
                for j in 0..width {
                    for i in 0..=j.min(order - 1) {
                        let found = dot(&column(i)[..=i], &column(j)[..=i]);
                        let left = (0..common + others).filter(|&k| !held[k]);
                        let expected: f64 = left.map(|k| row(k)[i] * row(k)[j]).sum();
                        assert!((found - expected).abs() < 1e-12, "{order} {i} {j}: {found} {expected}");
                    }
                }
                held.fill(false);
            }
            shared.clear();
            assert!(shared.is_empty());
        }
    }

    #[test]
    fn rows_of_zeros_change_nothing() {
        let mut shared = Shared::default();
        shared.start(2, 3, |j| &[[2.0, 0.0], [1.0, 3.0], [4.0, 5.0]][j]);
        shared.push(0, &[0.0; 3]);
        let mut out = [7.0; 6];
        shared.reduce(&[false], &mut out, 2, &pool(1)).unwrap();
        assert_close(&out, &[2.0, 7.0, 1.0, 3.0, 4.0, 5.0], 0.0);
    }

    /// Sets that have much in common are grouped, others are not, and a group does not grow without end.
    #[test]
    fn sets_are_grouped_where_that_pays() {
        let around = |start: usize| (start..start + 300).collect::<Vec<usize>>();
        let sets = [0, 10, 20, 400, 690, 695].map(around);
        let found = groups(&sets, 1000, (1000, 20));
        let ranges: Vec<Range<usize>> = found.iter().map(|group| group.sets.clone()).collect();
        assert_eq!(ranges, [0..3, 3..4, 4..6]);
        assert_eq!(found[0].union, (0..320).collect::<Vec<_>>());
        assert!(found[1].union.is_empty());
        assert!(found[0].cost < found[1].cost + found[2].cost && found[1].cost < found[2].cost);
        assert_eq!(found[2].union, (690..995).collect::<Vec<_>>());
        let many = vec![around(500); 2 * MOST_SETS + 1];
        let sizes: Vec<usize> =
            groups(&many, 1000, (2000, 20)).iter().map(|group| group.sets.len()).collect();
        assert_eq!(sizes, [MOST_SETS, MOST_SETS, 1]);
        assert!(groups(&[], 10, (10, 2)).is_empty());
    }
}
