//! The arrays of a least-squares problem, kept by the models that go back to them.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{matrix, slice};
use crate::fit::factor::Problem;

/// The caller's arrays of a problem, a tuple, kept, not copied: pairs close to rank loss go back to them.
#[derive(FromPyObject)]
pub(super) struct KeptArrays {
    #[pyo3(item(0))]
    pub(super) design: Py<PyArray2<f64>>,
    #[pyo3(item(1))]
    pub(super) responses: Py<PyArray2<f64>>,
    #[pyo3(item(2))]
    pub(super) root_weights: Option<Py<PyArray1<f64>>>,
    #[pyo3(item(3))]
    pub(super) penalty: Py<PyArray2<f64>>,
}

impl KeptArrays {
    pub(super) fn borrow<'py>(&self, py: Python<'py>) -> PyResult<ProblemArrays<'py>> {
        let weights = self.root_weights.as_ref().map(|w| w.bind(py).try_readonly()).transpose()?;
        Ok(ProblemArrays {
            design: self.design.bind(py).try_readonly()?,
            responses: self.responses.bind(py).try_readonly()?,
            root_weights: weights,
            penalty: self.penalty.bind(py).try_readonly()?,
        })
    }
}

/// The arrays of a problem, borrowed for one call.
pub(super) struct ProblemArrays<'py> {
    design: PyReadonlyArray2<'py, f64>,
    responses: PyReadonlyArray2<'py, f64>,
    root_weights: Option<PyReadonlyArray1<'py, f64>>,
    penalty: PyReadonlyArray2<'py, f64>,
}

impl ProblemArrays<'_> {
    pub(super) fn problem(&self) -> PyResult<Problem<'_>> {
        Ok(Problem {
            design: matrix(&self.design)?,
            responses: matrix(&self.responses)?,
            root_weights: self.root_weights.as_ref().map(slice).transpose()?,
            penalty: matrix(&self.penalty)?,
            rows: self.design.shape()[0],
            columns: self.design.shape()[1],
        })
    }
}
