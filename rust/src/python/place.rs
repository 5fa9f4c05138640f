//! Where control points go.

use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Array1, Array2, indices, matrix, slice, table};
use super::interrupt::interruptible;
use crate::place::{self, by_residual};

/// Lloyd's algorithm over samples of a region.
#[pyfunction]
pub(super) fn lloyd<'py>(
    py: Python<'py>,
    samples: PyReadonlyArray2<'py, f64>,
    start: PyReadonlyArray2<'py, f64>,
    max_steps: usize,
    tolerance: f64,
    threads: usize,
) -> PyResult<Array2<'py, f64>> {
    let count = start.shape()[0];
    let cost = (samples.shape()[0] * count * max_steps) as f64;
    let (samples, start) = (matrix(&samples)?, matrix(&start)?);
    let centres = interruptible(py, cost, threads, |pool| {
        place::lloyd::lloyd(samples, start, max_steps, tolerance, pool)
    })?;
    table(py, centres, count, 2)
}

/// Samples drawn for a start: indices.
#[pyfunction]
pub(super) fn spread<'py>(
    py: Python<'py>,
    samples: PyReadonlyArray2<'py, f64>,
    draws: PyReadonlyArray1<'py, f64>,
) -> PyResult<Array1<'py, i64>> {
    let cost = (samples.shape()[0] * draws.shape()[0]) as f64;
    let (samples, draws) = (matrix(&samples)?, slice(&draws)?);
    let drawn = interruptible(py, cost, 1, |pool| place::lloyd::spread(samples, draws, pool))?;
    Ok(indices(py, drawn))
}

/// The data that become control points, in the order of their arrival; `least` are a distance and a residual.
#[pyfunction]
pub(super) fn place_by_residual<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    values: PyReadonlyArray2<'py, f64>,
    first: [usize; 3],
    max_count: usize,
    least: (f64, f64),
    threads: usize,
) -> PyResult<Array1<'py, i64>> {
    let count = max_count.min(points.shape()[0]);
    let cost = 2.0 * points.shape()[0] as f64 * (count as f64).powi(2);
    let (points, values) = (matrix(&points)?, matrix(&values)?);
    let chosen = interruptible(py, cost, threads, |pool| {
        by_residual::place_by_residual(points, values, first, max_count, least.0, least.1, pool)
    })?;
    Ok(indices(py, chosen))
}
