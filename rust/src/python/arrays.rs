//! NumPy's arrays as slices and sets, and back.
//!
//! Indices come as int64 arrays seen as unsigned: a negative one is beyond every bound.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pulp::Arch;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::interrupt::interruptible;
use crate::sets::Sets;

#[cfg(not(target_pointer_width = "64"))]
compile_error!("indices of 64 bits are read in place");

pub(super) type Array1<'py, T> = Bound<'py, PyArray1<T>>;
pub(super) type Array2<'py, T> = Bound<'py, PyArray2<T>>;
pub(super) type Arrays<'py> = (Array1<'py, i64>, Array1<'py, i64>);

/// Sets in compressed rows, offsets and members, read where they are: they may take gigabytes.
#[derive(FromPyObject)]
pub(super) struct ReadSets<'py>(PyReadonlyArray1<'py, usize>, PyReadonlyArray1<'py, usize>);

impl ReadSets<'_> {
    pub(super) fn sets(&self) -> PyResult<Sets<'_>> {
        let (offsets, items) = (slice(&self.0)?, slice(&self.1)?);
        let whole = offsets.first() == Some(&0) && offsets.last() == Some(&items.len());
        if !(whole && offsets.is_sorted()) {
            return Err(PyValueError::new_err("offsets do not cut the items into sets"));
        }
        Ok(Sets { offsets: offsets.into(), items: items.into() })
    }
}

pub(super) fn slice<'a, T: numpy::Element>(array: &'a PyReadonlyArray1<'_, T>) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|_| PyValueError::new_err("array is not contiguous"))
}

pub(super) fn matrix<'a, T: numpy::Element>(array: &'a PyReadonlyArray2<'_, T>) -> PyResult<&'a [T]> {
    if array.is_c_contiguous() { array.as_slice().ok() } else { None }
        .ok_or_else(|| PyValueError::new_err("array is not contiguous"))
}

pub(super) fn indices(py: Python<'_>, values: Vec<usize>) -> Array1<'_, i64> {
    // Collected in place: no second list.
    PyArray1::from_vec(py, values.into_iter().map(|i| i as i64).collect())
}

pub(super) fn arrays<'py>(py: Python<'py>, sets: Sets<'_>) -> Arrays<'py> {
    (indices(py, sets.offsets.into_owned()), indices(py, sets.items.into_owned()))
}

pub(super) fn table<'py>(
    py: Python<'py>,
    values: Vec<f64>,
    rows: usize,
    columns: usize,
) -> PyResult<Array2<'py, f64>> {
    PyArray1::from_vec(py, values).reshape([rows, columns])
}

/// Entries that are looked at between two looks for Ctrl-C.
const AT_ONCE: usize = 1 << 20;

/// Numbers that are compared side by side.
const LANES: usize = 8;

/// The largest absolute value; NaN unless all are finite.
#[pyfunction]
pub(super) fn largest(py: Python<'_>, values: PyReadonlyArray1<'_, f64>) -> PyResult<f64> {
    let values = slice(&values)?;
    interruptible(py, values.len() as f64, 1, |pool| {
        let (arch, mut largest, mut nothing) = (Arch::new(), [0.0; LANES], [0.0; LANES]);
        for part in values.chunks(AT_ONCE) {
            pool.proceed()?;
            let (whole, rest) = part.as_chunks::<LANES>();
            let mut last = [0.0; LANES];
            last[..rest.len()].copy_from_slice(rest);
            arch.dispatch(|| {
                whole.iter().chain([&last]).for_each(|lanes| {
                    for ((x, largest), nothing) in lanes.iter().zip(&mut largest).zip(&mut nothing) {
                        *largest = if x.abs() > *largest { x.abs() } else { *largest };
                        // NaN as soon as a number is not finite.
                        *nothing += x * 0.0;
                    }
                });
            });
        }
        Ok(largest.into_iter().fold(0.0, f64::max) + nothing.into_iter().sum::<f64>())
    })
}

/// Whether these are sets of indices below a bound that increase in each set.
#[pyfunction]
pub(super) fn are_sets(
    py: Python<'_>,
    offsets: PyReadonlyArray1<'_, usize>,
    items: PyReadonlyArray1<'_, usize>,
    bound: usize,
) -> PyResult<bool> {
    let given = ReadSets(offsets, items);
    let Ok(sets) = given.sets() else { return Ok(false) };
    interruptible(py, sets.items.len() as f64, 1, |pool| sets.increase_below(bound, pool))
}
