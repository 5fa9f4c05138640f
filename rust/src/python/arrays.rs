//! NumPy's arrays as slices and sets, and back.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::sets::Sets;

pub(super) type Array1<'py, T> = Bound<'py, PyArray1<T>>;
pub(super) type Array2<'py, T> = Bound<'py, PyArray2<T>>;
pub(super) type Arrays<'py> = (Array1<'py, i64>, Array1<'py, i64>);
pub(super) type ReadSets<'py> = (PyReadonlyArray1<'py, i64>, PyReadonlyArray1<'py, i64>);

pub(super) fn slice<'a, T: numpy::Element>(array: &'a PyReadonlyArray1<'_, T>) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|_| PyValueError::new_err("array is not contiguous"))
}

pub(super) fn matrix<'a, T: numpy::Element>(array: &'a PyReadonlyArray2<'_, T>) -> PyResult<&'a [T]> {
    if array.is_c_contiguous() { array.as_slice().ok() } else { None }
        .ok_or_else(|| PyValueError::new_err("array is not contiguous"))
}

/// Numbers copied between two looks for Ctrl-C: lists of neighbourhoods have hundreds of millions.
const COPIED_AT_ONCE: usize = 1 << 22;

pub(super) fn numbers(values: &PyReadonlyArray1<'_, i64>) -> PyResult<Vec<usize>> {
    let mut copied = Vec::with_capacity(values.len());
    append(values, &mut copied)?;
    Ok(copied)
}

fn append(values: &PyReadonlyArray1<'_, i64>, copied: &mut Vec<usize>) -> PyResult<()> {
    for part in slice(values)?.chunks(COPIED_AT_ONCE) {
        values.py().check_signals()?;
        for &i in part {
            copied.push(usize::try_from(i).map_err(|_| PyValueError::new_err("negative index"))?);
        }
    }
    Ok(())
}

pub(super) fn sets((offsets, items): &ReadSets<'_>) -> PyResult<Sets> {
    let offsets = numbers(offsets)?;
    let whole = offsets.first() == Some(&0) && offsets.last() == Some(&items.len());
    if !(whole && offsets.is_sorted()) {
        return Err(PyValueError::new_err("offsets do not cut the items into sets"));
    }
    Ok(Sets { offsets, items: numbers(items)? })
}

pub(super) fn indices(py: Python<'_>, values: Vec<usize>) -> Array1<'_, i64> {
    // Collected in place: no second list.
    PyArray1::from_vec(py, values.into_iter().map(|i| i as i64).collect())
}

pub(super) fn arrays(py: Python<'_>, sets: Sets) -> Arrays<'_> {
    (indices(py, sets.offsets), indices(py, sets.items))
}

pub(super) fn table<'py>(
    py: Python<'py>,
    values: Vec<f64>,
    rows: usize,
    columns: usize,
) -> PyResult<Array2<'py, f64>> {
    PyArray1::from_vec(py, values).reshape([rows, columns])
}

/// Row and column of the first entry that is NaN or infinite.
#[pyfunction]
pub(super) fn find_not_finite(
    py: Python<'_>,
    values: PyReadonlyArray2<'_, f64>,
) -> PyResult<Option<(usize, usize)>> {
    let columns = values.shape()[1];
    let values = matrix(&values)?;
    // Blocks without an early exit vectorise: one pass at the speed of memory.
    let first = py.detach(|| {
        values.chunks(4096).enumerate().find_map(|(b, block)| {
            let finite = block.iter().fold(true, |finite, x| finite & x.is_finite());
            if finite { None } else { block.iter().position(|x| !x.is_finite()).map(|i| b * 4096 + i) }
        })
    });
    Ok(first.map(|i| (i / columns, i % columns)))
}
