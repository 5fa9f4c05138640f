//! Bending energies, and products that do not depend on the threads of NumPy's BLAS.

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Array2, matrix, table};
use super::interrupt::interruptible;
use crate::error::Error;
use crate::fit::bending;
use crate::fit::linalg::{self, transposed};

/// Weights (l + a, l) of cardinal splines and the rows (l - a, l) of their bending energy, of kernels (l, l) and affine
/// functions (l, a) at control points.
#[pyfunction]
pub(super) fn cardinal_splines<'py>(
    py: Python<'py>,
    kernels: PyReadonlyArray2<'py, f64>,
    affine: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<(Array2<'py, f64>, Array2<'py, f64>)> {
    let [order, width] = [affine.shape()[0], affine.shape()[1]];
    let (kernels, columns) = (matrix(&kernels)?, transposed(matrix(&affine)?, width));
    expect(kernels.len() == order * order && width <= order)?;
    let found = interruptible(py, (order as f64).powi(3), threads, |pool| {
        bending::cardinal(kernels, &columns, order, pool)
    })?;
    let weights = transposed(&found.weights, order + width);
    Ok((table(py, weights, order + width, order)?, table(py, found.bending, order - width, order)?))
}

/// The triangle (l - a, l - a) of which leading parts are the rows of the bending energy of leading kernels (l, l), less shares
/// (l, a) of the first a ones.
#[pyfunction]
pub(super) fn leading_bending<'py>(
    py: Python<'py>,
    kernels: PyReadonlyArray2<'py, f64>,
    shares: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array2<'py, f64>> {
    let [order, width] = [shares.shape()[0], shares.shape()[1]];
    let (kernels, columns) = (matrix(&kernels)?, transposed(matrix(&shares)?, width));
    expect(kernels.len() == order * order && width <= order)?;
    let found = interruptible(py, 2.0 * (order as f64).powi(3), threads, |pool| {
        bending::leading(kernels, &columns, order, pool)
    })?;
    let count = order - width;
    table(py, transposed(&found, count), count, count)
}

/// As few rows (l - a, l) as have the energy of the given ones (m, l), and none for affine functions (l, a).
#[pyfunction]
pub(super) fn reduced_bending<'py>(
    py: Python<'py>,
    rows: PyReadonlyArray2<'py, f64>,
    affine: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array2<'py, f64>> {
    let [order, width] = [affine.shape()[0], affine.shape()[1]];
    expect(rows.shape()[1] == order && width <= order && rows.shape()[0] + width >= order)?;
    let cost = 4.0 * rows.len() as f64 * order as f64;
    let (rows, columns) = (matrix(&rows)?, transposed(matrix(&affine)?, width));
    let found = interruptible(py, cost, threads, |pool| bending::reduced(rows, &columns, order, pool))?;
    table(py, found, order - width, order)
}

/// a @ b, whatever the threads of NumPy's BLAS.
#[pyfunction]
pub(super) fn product<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array2<'py, f64>> {
    let [rows, inner, columns] = [a.shape()[0], a.shape()[1], b.shape()[1]];
    expect(b.shape()[0] == inner)?;
    let (a, b) = (matrix(&a)?, matrix(&b)?);
    // Of matrices in rows, the transposed one in columns.
    let values = interruptible(py, (rows * inner * columns) as f64, threads, |pool| {
        linalg::product_in_blocks(b, a, (columns, inner, rows), pool)
    })?;
    table(py, values, rows, columns)
}

fn expect(shapes_agree: bool) -> Result<(), Error> {
    if shapes_agree { Ok(()) } else { Err(Error::Length { expected: 1, given: 0 }) }
}
