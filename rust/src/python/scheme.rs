//! Schemes as Python gives them.

use numpy::PyReadonlyArray1;
use pyo3::prelude::*;

use super::arrays::{ReadSets, slice};
use super::near::LazyNeighbourhoods;
use crate::holdout::scheme::{Held, Scheme};
use crate::near::neighbours;
use crate::sets::Sets;

/// What pairs hold out, and an order of the pairs.
#[derive(FromPyObject)]
pub(super) struct ReadScheme<'py>(HeldOut<'py>, Option<PyReadonlyArray1<'py, usize>>);

/// Listed sets with the validated ones, or neighbourhoods of data that are validated alone.
#[derive(FromPyObject)]
enum HeldOut<'py> {
    Listed(ReadSets<'py>, ReadSets<'py>),
    #[pyo3(transparent)]
    Lazy(PyRef<'py, LazyNeighbourhoods>),
}

/// A scheme whose arrays have been looked at.
pub(super) struct Listing<'a>(Pairs<'a>, Option<&'a [usize]>);

enum Pairs<'a> {
    Listed(Sets<'a>, Sets<'a>),
    Lazy(&'a neighbours::LazyNeighbourhoods),
}

impl ReadScheme<'_> {
    pub(super) fn listing(&self) -> PyResult<Listing<'_>> {
        let pairs = match &self.0 {
            HeldOut::Listed(held, validated) => Pairs::Listed(held.sets()?, validated.sets()?),
            HeldOut::Lazy(lazy) => Pairs::Lazy(&lazy.0),
        };
        Ok(Listing(pairs, self.1.as_ref().map(slice).transpose()?))
    }
}

impl Listing<'_> {
    pub(super) fn scheme(&self) -> Scheme<'_> {
        let (held, validated) = match &self.0 {
            Pairs::Listed(held, validated) => (Held::Sets(held), validated),
            Pairs::Lazy(lazy) => (Held::Lazy(lazy), &lazy.singletons),
        };
        Scheme { held, validated, order: self.1 }
    }
}
