//! Models of leading columns, and what their schemes hold out.

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

use super::arrays::{Array1, Array2, ReadSets, indices, slice, table};
use super::interrupt::interruptible;
use super::problem::KeptArrays;
use super::scheme::{Listing, ReadScheme};
use crate::holdout::nested;
use crate::holdout::scheme::Scheme;

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
        let size = problem.design.len() + problem.penalty.len();
        // Without full rank, some singular values as well.
        let cost = 4.0 * (size * problem.columns) as f64 + 100.0 * (problem.columns as f64).powi(3);
        let models = interruptible(py, cost, threads, |pool| nested::Nested::new(&problem, pool))?;
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
        sizes: PyReadonlyArray1<'py, usize>,
        threads: usize,
    ) -> PyResult<(Array1<'py, f64>, Array1<'py, f64>, Array1<'py, i64>)> {
        let sizes = slice(&sizes)?;
        let cost = self.models.fits_cost();
        let fits = interruptible(py, cost, threads, |pool| self.models.fits(sizes, pool))?;
        Ok((
            PyArray1::from_iter(py, fits.iter().map(|fit| fit.squares)),
            PyArray1::from_iter(py, fits.iter().map(|fit| fit.parameters)),
            PyArray1::from_iter(py, fits.iter().map(|fit| fit.rank as i64)),
        ))
    }

    /// (squares by size, number of sizes that are defined by pair) of each scheme, of the pairs that its order
    /// lists.
    fn curves<'py>(
        &self,
        py: Python<'py>,
        schemes: Vec<ReadScheme<'py>>,
        rows: ReadSets<'py>,
        sizes: PyReadonlyArray1<'py, usize>,
        threads: usize,
    ) -> PyResult<Vec<(Array1<'py, f64>, Array1<'py, i64>)>> {
        let lists = schemes.iter().map(ReadScheme::listing).collect::<PyResult<Vec<_>>>()?;
        let schemes: Vec<Scheme<'_>> = lists.iter().map(Listing::scheme).collect();
        let (rows, sizes) = (rows.sets()?, slice(&sizes)?);
        let arrays = self.arrays.borrow(py)?;
        let problem = arrays.problem()?;
        let found = interruptible(py, self.models.curves_cost(&schemes), threads, |pool| {
            self.models.curves(&problem, &schemes, &rows, sizes, pool)
        })?;
        Ok(found
            .into_iter()
            .map(|curve| (PyArray1::from_vec(py, curve.squares), indices(py, curve.defined)))
            .collect())
    }
}
