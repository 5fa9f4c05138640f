//! Models of leading columns, and what their schemes hold out.

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

use super::arrays::{Array1, Array2, ReadSets, indices, numbers, sets, table};
use super::interrupt::interruptible;
use super::near::LazyNeighbourhoods;
use super::problem::KeptArrays;
use crate::holdout::nested;
use crate::holdout::scheme::{Held, Scheme};
use crate::near::neighbours;
use crate::sets::Sets;

/// Models of leading columns.
#[pyclass(frozen, module = "mexpress._core")]
pub(super) struct Nested {
    models: nested::Nested,
    arrays: KeptArrays,
}

#[pymethods]
impl Nested {
    #[new]
    fn new(py: Python<'_>, arrays: KeptArrays, threads: usize) -> PyResult<Self> {
        let borrowed = arrays.borrow(py)?;
        let problem = borrowed.problem()?;
        let models = interruptible(py, f64::INFINITY, threads, |pool| nested::Nested::new(&problem, pool))?;
        Ok(Self { models, arrays })
    }

    /// The coefficients of the model of the first columns.
    fn coefficients<'py>(&self, py: Python<'py>, size: usize) -> PyResult<Array2<'py, f64>> {
        let transposed = self.models.coefficients(size);
        let responses = transposed.len() / size.max(1);
        table(py, transposed, responses, size)?.transpose()
    }

    /// (squares, parameters, ranks) of the fits with these numbers of columns.
    fn fits<'py>(
        &self,
        py: Python<'py>,
        sizes: PyReadonlyArray1<'py, i64>,
        threads: usize,
    ) -> PyResult<(Array1<'py, f64>, Array1<'py, f64>, Array1<'py, i64>)> {
        let sizes = numbers(&sizes)?;
        let fits = interruptible(py, f64::INFINITY, threads, |pool| self.models.fits(&sizes, pool))?;
        Ok((
            PyArray1::from_iter(py, fits.iter().map(|fit| fit.squares)),
            PyArray1::from_iter(py, fits.iter().map(|fit| fit.parameters)),
            PyArray1::from_iter(py, fits.iter().map(|fit| fit.rank as i64)),
        ))
    }

    /// (squares by size, number of sizes that are defined by pair) of each scheme, given as what is held out, what is
    /// validated, and the pairs to be visited. Without validated sets it is each datum alone.
    fn curves<'py>(
        &self,
        py: Python<'py>,
        schemes: Vec<(HeldOut<'py>, PyReadonlyArray1<'py, i64>)>,
        rows: ReadSets<'py>,
        sizes: PyReadonlyArray1<'py, i64>,
        threads: usize,
    ) -> PyResult<Vec<(Array1<'py, f64>, Array1<'py, i64>)>> {
        let lists = schemes
            .iter()
            .map(|(held, order)| Ok((held.read()?, numbers(order)?)))
            .collect::<PyResult<Vec<_>>>()?;
        let schemes: Vec<Scheme<'_>> = lists.iter().map(|(listing, order)| listing.scheme(order)).collect();
        let (rows, sizes) = (sets(&rows)?, numbers(&sizes)?);
        let arrays = self.arrays.borrow(py)?;
        let problem = arrays.problem()?;
        let found = interruptible(py, f64::INFINITY, threads, |pool| {
            self.models.curves(&problem, &schemes, &rows, &sizes, pool)
        })?;
        Ok(found
            .into_iter()
            .map(|curve| (PyArray1::from_vec(py, curve.squares), indices(py, curve.defined)))
            .collect())
    }
}

/// What pairs hold out: listed sets with the validated ones, or neighbourhoods of data that are validated alone.
#[derive(FromPyObject)]
enum HeldOut<'py> {
    Listed(ReadSets<'py>, ReadSets<'py>),
    #[pyo3(transparent)]
    Lazy(PyRef<'py, LazyNeighbourhoods>),
}

enum Listing<'a> {
    Sets(Sets, Sets),
    Lazy(&'a neighbours::LazyNeighbourhoods),
}

impl HeldOut<'_> {
    fn read(&self) -> PyResult<Listing<'_>> {
        match self {
            Self::Listed(held, validated) => Ok(Listing::Sets(sets(held)?, sets(validated)?)),
            Self::Lazy(lazy) => Ok(Listing::Lazy(&lazy.0)),
        }
    }
}

impl Listing<'_> {
    fn scheme<'a>(&'a self, order: &'a [usize]) -> Scheme<'a> {
        match self {
            Self::Sets(held, validated) => Scheme { held: Held::Sets(held), validated, order: Some(order) },
            Self::Lazy(lazy) => {
                Scheme { held: Held::Lazy(lazy), validated: &lazy.singletons, order: Some(order) }
            }
        }
    }
}
