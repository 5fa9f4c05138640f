//! Lists of index sets in compressed rows.

/// Neighbourhoods of more members in all than this (3 GB) are refused rather than left to exhaust the memory.
pub const MOST_MEMBERS: usize = 400_000_000;

/// Sets of indices laid end to end: set `s` is `items[offsets[s]..offsets[s + 1]]`.
///
/// ```
/// use mexpress::sets::Sets;
/// let sets: Sets = [vec![0, 2], vec![], vec![1]].into_iter().collect();
/// assert_eq!(sets.len(), 3);
/// assert_eq!(sets.get(0), &[0, 2]);
/// assert_eq!(sets.total(&[0, 2]), 3);
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sets {
    /// One more than the number of sets; starts at zero, never decreases.
    pub offsets: Vec<usize>,
    /// The members, set after set.
    pub items: Vec<usize>,
}

impl Sets {
    /// Number of sets.
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

    /// Members of set `s`.
    pub fn get(&self, s: usize) -> &[usize] {
        &self.items[self.offsets[s]..self.offsets[s + 1]]
    }
}

impl FromIterator<Vec<usize>> for Sets {
    fn from_iter<I: IntoIterator<Item = Vec<usize>>>(sets: I) -> Self {
        let (mut offsets, mut items) = (vec![0], Vec::new());
        for set in sets {
            items.extend_from_slice(&set);
            offsets.push(items.len());
        }
        Self { offsets, items }
    }
}
