//! What is held out and what of it is predicted: plain data.

use crate::error::Error;
use crate::fit::factor::expect_length;
use crate::near::neighbours::LazyNeighbourhoods;
use crate::sets::Sets;

/// Held-out and validated data of pairs.
#[derive(Clone, Copy)]
pub struct Scheme<'a> {
    /// Held-out data of each pair.
    pub held: Held<'a>,
    /// Validated data of each pair, a subset of those held out.
    pub validated: &'a Sets<'a>,
    /// The pairs in an order in which successive ones are near each other, if one is known: they then share most of what
    /// they hold out. Without it they are visited as listed.
    pub order: Option<&'a [usize]>,
}

/// Data that pairs hold out.
#[derive(Clone, Copy)]
pub enum Held<'a> {
    /// Listed.
    Sets(&'a Sets<'a>),
    /// Neighbourhoods, found when they are needed.
    Lazy(&'a LazyNeighbourhoods),
}

impl<'a> Held<'a> {
    /// The sets, if they are listed.
    pub(super) fn listed(self) -> Option<&'a Sets<'a>> {
        match self {
            Self::Sets(sets) => Some(sets),
            Self::Lazy(_) => None,
        }
    }

    fn len(self) -> usize {
        match self {
            Self::Sets(sets) => sets.len(),
            Self::Lazy(lazy) => lazy.singletons.len(),
        }
    }

    /// About how many data a pair holds out.
    pub(crate) fn mean(self) -> f64 {
        match self {
            Self::Sets(sets) => sets.items.len() as f64 / sets.len().max(1) as f64,
            Self::Lazy(lazy) => lazy.mean,
        }
    }

    /// The most data that a pair holds out; of neighbourhoods about that.
    pub(super) fn largest(self) -> usize {
        match self {
            Self::Sets(sets) => (0..sets.len()).map(|s| sets.get(s).len()).max().unwrap_or(0),
            Self::Lazy(lazy) => (2.0 * lazy.mean) as usize,
        }
    }

    pub(crate) fn members(self, pair: usize, out: &mut Vec<usize>) {
        match self {
            Self::Sets(sets) => {
                out.clear();
                out.extend_from_slice(sets.get(pair));
            }
            Self::Lazy(lazy) => lazy.members(pair, out),
        }
    }
}

impl Scheme<'_> {
    /// How many pairs are visited.
    pub(super) fn steps(&self) -> usize {
        self.order.map_or(self.held.len(), <[usize]>::len)
    }

    /// Fails unless these are pairs of sets of the data that have these rows.
    pub(crate) fn check(&self, rows: &Sets) -> Result<(), Error> {
        let count = self.held.len();
        if let Held::Sets(held) = self.held {
            check_indices(held, rows.len())?;
        }
        check_indices(self.validated, rows.len())?;
        expect_length(self.validated.len(), count)?;
        match self.order.and_then(|order| order.iter().max()) {
            Some(&index) if index >= count => Err(Error::Index { index, bound: count }),
            _ => Ok(()),
        }
    }
}

/// Fails unless all members are below a bound.
pub(crate) fn check_indices(sets: &Sets, bound: usize) -> Result<(), Error> {
    expect_length(sets.items.len(), *sets.offsets.last().unwrap_or(&0))?;
    match sets.items.iter().max() {
        Some(&index) if index >= bound => Err(Error::Index { index, bound }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scheme_names_data_and_pairs_that_exist() {
        let (held, validated): (Sets, Sets) =
            ([vec![0, 1], vec![2]].into_iter().collect(), [vec![0], vec![2]].into_iter().collect());
        let rows = |count: usize| (0..count).map(|i| vec![i]).collect::<Sets>();
        let scheme = |order| Scheme { held: Held::Sets(&held), validated: &validated, order };
        assert_eq!(scheme(None).check(&rows(3)), Ok(()));
        assert_eq!(scheme(None).check(&rows(2)), Err(Error::Index { index: 2, bound: 2 }));
        assert_eq!(scheme(Some(&[1, 2])).check(&rows(3)), Err(Error::Index { index: 2, bound: 2 }));
        let one: Sets = [vec![0]].into_iter().collect();
        let short = Scheme { validated: &one, ..scheme(None) };
        assert_eq!(short.check(&rows(3)), Err(Error::Length { expected: 2, given: 1 }));
        assert_eq!((scheme(Some(&[1])).steps(), scheme(None).steps()), (1, 2));
    }
}
