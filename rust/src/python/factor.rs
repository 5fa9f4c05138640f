//! One least-squares problem and its pairs.

use std::ops::Range;

use numpy::{PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Array1, Array2, ReadSets, indices, matrix, table};
use super::interrupt::interruptible;
use super::problem::KeptArrays;
use super::scheme::{Listing, ReadScheme};
use crate::error::Error;
use crate::fit::{self, factor};
use crate::holdout::residuals::{Predictions, Status};
use crate::holdout::scheme::Scheme;
use crate::sets::Sets;

/// Score, residuals, their rows and pairs, and the pairs that are undefined.
type Predicted<'py> = (f64, Array2<'py, f64>, Array1<'py, i64>, Array1<'py, i64>, Array1<'py, i64>);

/// A fitted least-squares problem.
#[pyclass(frozen, module = "mexpress._core")]
pub(super) struct Factor {
    pub(super) fit: factor::Factor,
    pub(super) arrays: KeptArrays,
}

#[pymethods]
impl Factor {
    /// `counted` tells for how many rows these stand, if they stand for more.
    #[new]
    #[pyo3(signature = (arrays, threads, counted = 0))]
    fn new(py: Python<'_>, arrays: KeptArrays, threads: usize, counted: usize) -> PyResult<Self> {
        let borrowed = arrays.borrow(py)?;
        let problem = borrowed.problem()?;
        let size = problem.design.len() + problem.penalty.len();
        let cost = 2.0 * (size * problem.columns) as f64;
        let counted = counted.max(problem.total_rows());
        let fit =
            interruptible(py, cost, threads, |pool| factor::Factor::standing_for(&problem, counted, pool))?;
        Ok(Self { fit, arrays })
    }

    #[getter]
    fn rank(&self) -> usize {
        self.fit.rank
    }

    #[getter]
    fn coefficients<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let transposed = table(py, self.fit.coefficients.clone(), self.fit.responses, self.fit.columns)?;
        transposed.transpose()
    }

    #[getter]
    fn residuals<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        table(py, self.fit.plain_residuals(), self.fit.rows, self.fit.responses)
    }

    /// Of data that have these rows.
    fn fit_rms(&self, rows: ReadSets<'_>) -> PyResult<f64> {
        Ok(self.fit.fit_rms(&rows.sets()?))
    }

    #[getter]
    fn leverage<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        PyArray1::from_slice(py, &self.fit.leverage)
    }

    /// (score, residuals, rows, pairs, undefined pairs) of each scheme.
    fn predict<'py>(
        &self,
        py: Python<'py>,
        schemes: Vec<ReadScheme<'py>>,
        rows: ReadSets<'py>,
        threads: usize,
    ) -> PyResult<Vec<Predicted<'py>>> {
        let lists = schemes.iter().map(ReadScheme::listing).collect::<PyResult<Vec<_>>>()?;
        let schemes: Vec<Scheme<'_>> = lists.iter().map(Listing::scheme).collect();
        let rows = rows.sets()?;
        let walked = interruptible(py, self.fit.walk_cost(&schemes, &rows), threads, |pool| {
            self.fit.walk(&schemes, &rows, pool)
        })?;
        let arrays = self.arrays.borrow(py)?;
        let problem = arrays.problem()?;
        let found = interruptible(py, walked.finish_cost(), threads, |pool| walked.finish(&problem, pool))?;
        let mut first = 0;
        let predicted = |scheme: &Scheme<'_>| {
            let pairs = first..first + scheme.validated.len();
            first = pairs.end;
            self.predicted(py, &found, pairs, scheme.validated, &rows)
        };
        schemes.iter().map(predicted).collect()
    }

    /// The covariances of the prediction residuals of pairs, flattened one after another.
    fn spread<'py>(
        &self,
        py: Python<'py>,
        scheme: ReadScheme<'py>,
        rows: ReadSets<'py>,
        threads: usize,
    ) -> PyResult<Array1<'py, f64>> {
        let (listing, rows) = (scheme.listing()?, rows.sets()?);
        let arrays = self.arrays.borrow(py)?;
        let problem = arrays.problem()?;
        // At worst every pair is refitted.
        let cost = listing.scheme().validated.len() as f64 * self.fit.refit_cost();
        let blocks = interruptible(py, cost, threads, |pool| {
            self.fit.spread(&problem, &listing.scheme(), &rows, pool)
        })?;
        Ok(PyArray1::from_vec(py, blocks))
    }

    /// Rows (k, p) of the design's columns over its basis: `a R^-1`.
    fn over_basis<'py>(
        &self,
        py: Python<'py>,
        rows: PyReadonlyArray2<'py, f64>,
        threads: usize,
    ) -> PyResult<Array2<'py, f64>> {
        let [count, columns] = [rows.shape()[0], rows.shape()[1]];
        if columns != self.fit.columns {
            return Err(Error::Length { expected: self.fit.columns, given: columns }.into());
        }
        let rows = matrix(&rows)?;
        let cost = (rows.len() * columns) as f64;
        let over = interruptible(py, cost, threads, |pool| self.fit.over_basis(rows, pool))?;
        table(py, over, count, columns)
    }

    /// Rows of the basis times the roots of their weights, (m, rank).
    #[getter]
    fn weighted_basis<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        table(py, self.fit.weighted_basis(), self.fit.rows, self.fit.rank)
    }

    /// The blocks of the hat matrix for sets of rows, flattened one after another.
    fn hat_blocks<'py>(
        &self,
        py: Python<'py>,
        rows: ReadSets<'py>,
        threads: usize,
    ) -> PyResult<Array1<'py, f64>> {
        let rows = rows.sets()?;
        let squares: f64 = (0..rows.len()).map(|s| (rows.get(s).len() as f64).powi(2)).sum();
        let cost = squares * self.fit.rank as f64;
        let blocks = interruptible(py, cost, threads, |pool| self.fit.hat_blocks(&rows, pool))?;
        Ok(PyArray1::from_vec(py, blocks))
    }
}

/// The triangles of successive cells of a matrix, (cells, columns, columns).
#[pyfunction]
pub(super) fn triangles<'py>(
    py: Python<'py>,
    rows: PyReadonlyArray2<'py, f64>,
    cell: usize,
    threads: usize,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let columns = rows.shape()[1];
    let rows = matrix(&rows)?;
    let cost = 2.0 * (rows.len() * columns) as f64;
    let found =
        interruptible(py, cost, threads, |pool| fit::triangles::triangles(rows, columns, cell, pool))?;
    PyArray1::from_vec(py, found).reshape([rows.len().div_ceil(cell * columns), columns, columns])
}

impl Factor {
    /// The part of the predictions that belongs to a scheme.
    fn predicted<'py>(
        &self,
        py: Python<'py>,
        found: &Predictions,
        pairs: Range<usize>,
        validated: &Sets<'_>,
        rows: &Sets<'_>,
    ) -> PyResult<Predicted<'py>> {
        let ends = &found.offsets[pairs.start..=pairs.end];
        let (first, count) = (ends[0], ends[ends.len() - 1] - ends[0]);
        let residuals = &found.residuals[first * self.fit.responses..][..count * self.fit.responses];
        let mut pair_of_row = Vec::with_capacity(count);
        for (pair, end) in ends.windows(2).enumerate() {
            pair_of_row.resize(end[1] - first, pair);
        }
        let undefined: Vec<usize> =
            (0..pairs.len()).filter(|pair| found.status[pairs.start + pair] == Status::Undefined).collect();
        let score = if undefined.is_empty() { self.fit.score(rows, validated, residuals) } else { f64::NAN };
        Ok((
            score,
            PyArray1::from_slice(py, residuals).reshape([count, self.fit.responses])?,
            indices(py, found.rows[first..][..count].to_vec()),
            indices(py, pair_of_row),
            indices(py, undefined),
        ))
    }
}
