//! Many small problems in one call.

use numpy::{PyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Array1, Arrays, ReadSets, indices, matrix};
use super::interrupt::interruptible;
use super::scheme::ReadScheme;
use crate::batch::{self, Run};

/// Problems of one shape: designs (k, m, p), responses (k, m, r), roots of weights (k, m), what is held out, and the rows
/// of each datum.
#[derive(FromPyObject)]
pub(super) struct ReadRun<'py>(
    PyReadonlyArray3<'py, f64>,
    PyReadonlyArray3<'py, f64>,
    Option<PyReadonlyArray2<'py, f64>>,
    ReadScheme<'py>,
    ReadSets<'py>,
);

/// Coefficients, prediction residuals, scores, fitting errors and ranks, flat, one problem after another; and the problems
/// and pairs that are undefined.
type Found<'py> =
    (Array1<'py, f64>, Array1<'py, f64>, Array1<'py, f64>, Array1<'py, f64>, Array1<'py, i64>, Arrays<'py>);

/// Fits and cross-validates every problem, run after run.
#[pyfunction]
pub(super) fn cross_validate_batch<'py>(
    py: Python<'py>,
    runs: Vec<ReadRun<'py>>,
    threads: usize,
) -> PyResult<Found<'py>> {
    let lists = runs.iter().map(|run| Ok((run.3.listing()?, run.4.sets()?)));
    let lists = lists.collect::<PyResult<Vec<_>>>()?;
    let mut batch = Vec::with_capacity(runs.len());
    for (run, (listing, data)) in runs.iter().zip(&lists) {
        batch.push(Run {
            designs: stack(&run.0)?,
            responses: stack(&run.1)?,
            root_weights: run.2.as_ref().map(matrix).transpose()?,
            count: run.0.shape()[0],
            rows: run.0.shape()[1],
            columns: run.0.shape()[2],
            scheme: listing.scheme(),
            data,
        });
    }
    // At worst every pair is refitted.
    let refit = |run: &Run<'_>| (run.designs.len() * run.columns) as f64;
    let cost = batch.iter().map(|run| refit(run) * (1 + run.scheme.validated.len()) as f64).sum();
    let found = interruptible(py, cost, threads, |pool| batch::cross_validate(&batch, pool))?;
    let (problems, pairs) = found.undefined.into_iter().unzip();
    Ok((
        PyArray1::from_vec(py, found.coefficients),
        PyArray1::from_vec(py, found.residuals),
        PyArray1::from_vec(py, found.scores),
        PyArray1::from_vec(py, found.fit_rms),
        indices(py, found.ranks),
        (indices(py, problems), indices(py, pairs)),
    ))
}

fn stack<'a>(array: &'a PyReadonlyArray3<'_, f64>) -> PyResult<&'a [f64]> {
    if array.is_c_contiguous() { array.as_slice().ok() } else { None }
        .ok_or_else(|| PyValueError::new_err("array is not contiguous"))
}
