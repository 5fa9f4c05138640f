//! One penalised problem at every weight.

use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Array2, matrix, table};
use super::factor::Factor;
use super::interrupt::interruptible;
use super::problem::KeptArrays;
use crate::fit::penalty_path;

/// A penalised least-squares problem, factorised for all weights of its penalty.
#[pyclass(frozen, module = "mexpress._core")]
pub(super) struct PenaltyPath {
    path: penalty_path::PenaltyPath,
    arrays: KeptArrays,
}

#[pymethods]
impl PenaltyPath {
    #[new]
    fn new(py: Python<'_>, arrays: KeptArrays, threads: usize) -> PyResult<Self> {
        let borrowed = arrays.borrow(py)?;
        let problem = borrowed.problem()?;
        let (p, size) = (problem.columns, problem.design.len() + problem.penalty.len());
        // A singular value decomposition of the columns' triangle takes tens of multiply-adds an entry and column.
        let cost = (4 * size * p + 30 * p.pow(3)) as f64;
        let path = interruptible(py, cost, threads, |pool| penalty_path::PenaltyPath::new(&problem, pool))?;
        Ok(Self { path, arrays })
    }

    #[getter]
    fn determined(&self) -> bool {
        self.path.determined()
    }

    #[getter]
    fn rank(&self) -> usize {
        self.path.rank()
    }

    /// The fit at a weight, in the coordinates of its basis, and the coefficients of the design.
    fn fit<'py>(&self, py: Python<'py>, weight: f64, threads: usize) -> PyResult<(Factor, Array2<'py, f64>)> {
        let kept = &self.arrays;
        let penalty = kept.penalty.bind(py);
        let root = weight.sqrt();
        let rows = matrix(&penalty.try_readonly()?)?.iter().map(|z| root * z).collect();
        let arrays = KeptArrays {
            design: kept.design.clone_ref(py),
            responses: kept.responses.clone_ref(py),
            root_weights: kept.root_weights.as_ref().map(|w| w.clone_ref(py)),
            penalty: PyArray1::from_vec(py, rows).reshape(penalty.dims())?.unbind(),
        };
        let borrowed = arrays.borrow(py)?;
        let problem = borrowed.problem()?;
        let responses = problem.responses.len() / problem.rows;
        let cost = (problem.design.len() * (2 + 4 * responses)) as f64;
        let (fit, coefficients) =
            interruptible(py, cost, threads, |pool| self.path.fit(&problem, weight, pool))?;
        let coefficients = table(py, coefficients, responses, problem.columns)?.transpose()?;
        Ok((Factor { fit, arrays }, coefficients))
    }
}
