//! Lists of index sets in compressed rows.

use std::borrow::Cow;

use crate::error::Error;
use crate::pool::Pool;

/// Neighbourhoods of more members in all than this (3 GB) are refused rather than left to exhaust the memory.
pub const MOST_MEMBERS: usize = 400_000_000;

/// Sets that are looked at between two looks at the flag of the pool.
const AT_ONCE: usize = 1 << 16;

/// Sets of indices laid end to end: set `s` is `items[offsets[s]..offsets[s + 1]]`. Lists of neighbourhoods may take
/// gigabytes, so they can be borrowed.
///
/// ```
/// use mexpress::sets::Sets;
/// let sets: Sets = [vec![0, 2], vec![], vec![1]].into_iter().collect();
/// assert_eq!(sets.len(), 3);
/// assert_eq!(sets.get(0), &[0, 2]);
/// assert_eq!(sets.total(&[0, 2]), 3);
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sets<'a> {
    /// One more than the number of sets; starts at zero, never decreases.
    pub offsets: Cow<'a, [usize]>,
    /// The members, set after set.
    pub items: Cow<'a, [usize]>,
}

impl Sets<'_> {
    /// Number of sets.
    #[inline]
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether there is no set at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many members some of the sets have in all.
    pub fn total(&self, some: &[usize]) -> usize {
        some.iter().map(|&s| self.get(s).len()).sum()
    }

    /// Whether the members of every set increase, to less than a bound.
    pub fn increase_below(&self, bound: usize, pool: &Pool<'_>) -> Result<bool, Error> {
        let increases = |s: usize| {
            let set = self.get(s);
            set.is_sorted_by(|a, b| a < b) && set.last().is_none_or(|&last| last < bound)
        };
        for first in (0..self.len()).step_by(AT_ONCE) {
            pool.proceed()?;
            if !(first..self.len().min(first + AT_ONCE)).all(increases) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Members of set `s`.
    #[inline]
    pub fn get(&self, s: usize) -> &[usize] {
        &self.items[self.offsets[s]..self.offsets[s + 1]]
    }
}

impl FromIterator<Vec<usize>> for Sets<'_> {
    fn from_iter<I: IntoIterator<Item = Vec<usize>>>(sets: I) -> Self {
        let (mut offsets, mut items) = (vec![0], Vec::new());
        for set in sets {
            items.extend_from_slice(&set);
            offsets.push(items.len());
        }
        (offsets, items).into()
    }
}

impl From<(Vec<usize>, Vec<usize>)> for Sets<'_> {
    fn from((offsets, items): (Vec<usize>, Vec<usize>)) -> Self {
        Self { offsets: offsets.into(), items: items.into() }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    #[test]
    fn sets_increase_below_a_bound() {
        let flag = AtomicBool::new(false);
        let increase = |sets: &[&[usize]], bound| {
            let sets: Sets = sets.iter().map(|set| set.to_vec()).collect();
            sets.increase_below(bound, &Pool::new(1, &flag)).unwrap()
        };
        assert!(increase(&[&[0, 3], &[], &[1, 2]], 4));
        assert!(!increase(&[&[0, 3], &[], &[1, 2]], 3), "3 is not below 3");
        assert!(!increase(&[&[0], &[2, 2]], 9), "2 comes twice");
        assert!(!increase(&[&[0], &[2, 1]], 9), "they fall");
        assert!(increase(&[], 0));
    }

    #[test]
    fn sets_are_what_they_were_made_of() {
        let lists = [vec![5, 1], vec![], vec![0, 2, 9], vec![]];
        let sets: Sets = lists.clone().into_iter().collect();
        assert_eq!((sets.len(), sets.is_empty()), (4, false));
        assert!((0..4).all(|s| sets.get(s) == lists[s]));
        assert_eq!((sets.total(&[0, 2, 2]), sets.total(&[])), (8, 0));
        let nothing: Sets = [].into_iter().collect();
        assert_eq!((nothing.len(), nothing.is_empty()), (0, true));
        // The same members in other sets are other sets.
        assert_ne!(sets, [vec![5], vec![1], vec![0, 2, 9], vec![]].into_iter().collect());
    }
}
