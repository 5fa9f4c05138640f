//! One least-squares problem and its pairs.

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

use super::arrays::{Array1, Array2, ReadSets, indices, numbers, sets, table};
use super::interrupt::interruptible;
use super::problem::KeptArrays;
use crate::fit::factor;
use crate::holdout::residuals::Status;
use crate::holdout::scheme::{Held, Scheme};
use crate::sets::Sets;

/// A fitted least-squares problem.
#[pyclass(frozen, module = "mexpress._core")]
pub(super) struct Factor {
    pub(super) fit: factor::Factor,
    pub(super) arrays: KeptArrays,
}

#[pymethods]
impl Factor {
    #[new]
    fn new(py: Python<'_>, arrays: KeptArrays, threads: usize) -> PyResult<Self> {
        let borrowed = arrays.borrow(py)?;
        let problem = borrowed.problem()?;
        let size = problem.design.len() + problem.penalty.len();
        let cost = 2.0 * (size * problem.columns) as f64;
        let fit = interruptible(py, cost, threads, |pool| factor::Factor::new(&problem, pool))?;
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

    #[getter]
    fn leverage<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        PyArray1::from_slice(py, &self.fit.leverage)
    }

    /// (residuals, rows, offsets, undefined) of the pairs of schemes, each given as what is held out, what is validated, and
    /// an order of its pairs.
    #[expect(clippy::type_complexity)]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        schemes: Vec<(ReadSets<'py>, ReadSets<'py>, Option<PyReadonlyArray1<'py, i64>>)>,
        rows: ReadSets<'py>,
        threads: usize,
    ) -> PyResult<(Array2<'py, f64>, Array1<'py, i64>, Array1<'py, i64>, Array1<'py, i64>)> {
        let read = |(held, validated, order): &(_, _, Option<_>)| {
            Ok((sets(held)?, sets(validated)?, order.as_ref().map(numbers).transpose()?))
        };
        let lists = schemes.iter().map(read).collect::<PyResult<Vec<(Sets, Sets, Option<Vec<usize>>)>>>()?;
        let schemes: Vec<Scheme<'_>> = lists
            .iter()
            .map(|(held, validated, order)| Scheme {
                held: Held::Sets(held),
                validated,
                order: order.as_deref(),
            })
            .collect();
        let rows = sets(&rows)?;
        // At worst every pair is refitted.
        let count: usize = lists.iter().map(|(held, ..)| held.len()).sum();
        let cost = 2.0 * count as f64 * (self.fit.basis.len() * self.fit.rank) as f64;
        let arrays = self.arrays.borrow(py)?;
        let problem = arrays.problem()?;
        let found =
            interruptible(py, cost, threads, |pool| self.fit.predict(&problem, &schemes, &rows, pool))?;
        let lost = (0..found.status.len()).filter(|&pair| found.status[pair] == Status::Undefined).collect();
        let count = found.rows.len();
        Ok((
            table(py, found.residuals, count, self.fit.responses)?,
            indices(py, found.rows),
            indices(py, found.offsets),
            indices(py, lost),
        ))
    }

    /// The covariances of the prediction residuals of pairs, flattened one after another.
    fn spread<'py>(
        &self,
        py: Python<'py>,
        held: ReadSets<'py>,
        validated: ReadSets<'py>,
        rows: ReadSets<'py>,
        threads: usize,
    ) -> PyResult<Array1<'py, f64>> {
        let (held, validated, rows) = (sets(&held)?, sets(&validated)?, sets(&rows)?);
        let scheme = Scheme { held: Held::Sets(&held), validated: &validated, order: None };
        let arrays = self.arrays.borrow(py)?;
        let problem = arrays.problem()?;
        let blocks = interruptible(py, f64::INFINITY, threads, |pool| {
            self.fit.spread(&problem, &scheme, &rows, pool)
        })?;
        Ok(PyArray1::from_vec(py, blocks))
    }

    /// The blocks of the hat matrix for sets of rows, flattened one after another.
    fn hat_blocks<'py>(
        &self,
        py: Python<'py>,
        rows: ReadSets<'py>,
        threads: usize,
    ) -> PyResult<Array1<'py, f64>> {
        let rows = sets(&rows)?;
        let squares: f64 = (0..rows.len()).map(|s| (rows.get(s).len() as f64).powi(2)).sum();
        let cost = squares * self.fit.rank as f64;
        let blocks = interruptible(py, cost, threads, |pool| self.fit.hat_blocks(&rows, pool))?;
        Ok(PyArray1::from_vec(py, blocks))
    }
}
