//! The arrays of a least-squares problem, kept by the models that go back to them.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Array1, Array2, matrix, slice};
use crate::fit::factor::Problem;

/// The caller's arrays of a problem, kept, not copied: pairs close to rank loss go back to them.
pub(super) struct KeptArrays {
    pub(super) design: Py<PyArray2<f64>>,
    pub(super) responses: Py<PyArray2<f64>>,
    pub(super) root_weights: Option<Py<PyArray1<f64>>>,
    pub(super) penalty: Py<PyArray2<f64>>,
}

impl KeptArrays {
    pub(super) fn borrow<'py>(&self, py: Python<'py>) -> PyResult<ProblemArrays<'py>> {
        let weights = self.root_weights.as_ref().map(|w| w.bind(py));
        ProblemArrays::new(self.design.bind(py), self.responses.bind(py), weights, self.penalty.bind(py))
    }
}

/// The arrays of a problem, borrowed for one call.
pub(super) struct ProblemArrays<'py> {
    design: PyReadonlyArray2<'py, f64>,
    responses: PyReadonlyArray2<'py, f64>,
    root_weights: Option<PyReadonlyArray1<'py, f64>>,
    penalty: PyReadonlyArray2<'py, f64>,
}

impl<'py> ProblemArrays<'py> {
    pub(super) fn new(
        design: &Array2<'py, f64>,
        responses: &Array2<'py, f64>,
        root_weights: Option<&Array1<'py, f64>>,
        penalty: &Array2<'py, f64>,
    ) -> PyResult<Self> {
        Ok(Self {
            design: design.try_readonly()?,
            responses: responses.try_readonly()?,
            root_weights: root_weights.map(|w| w.try_readonly()).transpose()?,
            penalty: penalty.try_readonly()?,
        })
    }

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
