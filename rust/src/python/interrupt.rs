//! Long work and Ctrl-C.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::error::Error;
use crate::pool::Pool;

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        match error {
            // The arguments are good; the arrays kept from before are not.
            Error::Changed { .. } => PyRuntimeError::new_err(error.to_string()),
            _ => PyValueError::new_err(error.to_string()),
        }
    }
}

/// Multiply-adds that pass before anybody presses Ctrl-C: shorter work is done at once, on this thread.
const SHORT: f64 = 2e8;

/// Multiply-adds that are done before another thread has woken up for them.
const ALONE: f64 = 1e6;

/// Does the work with the interpreter released. Signals reach the main thread alone, so long work goes to another one
/// while this one looks for them.
pub(super) fn interruptible<T: Send>(
    py: Python<'_>,
    cost: f64,
    threads: usize,
    work: impl FnOnce(&Pool<'_>) -> Result<T, Error> + Send,
) -> PyResult<T> {
    let cancel = AtomicBool::new(false);
    let pool = Pool::new(if cost < ALONE { 1 } else { threads }, &cancel);
    if cost < SHORT {
        return Ok(py.detach(|| work(&pool))?);
    }
    let mut signal = Ok(());
    let watch = |signal: &mut PyResult<()>| {
        let (done, finished) = channel::<()>();
        std::thread::scope(|scope| {
            let worker = scope.spawn(|| {
                // Dropped when the work ends, however it ends.
                let _done = done;
                work(&pool)
            });
            while finished.recv_timeout(Duration::from_millis(50)) == Err(RecvTimeoutError::Timeout) {
                if signal.is_ok() {
                    *signal = Python::attach(|py| py.check_signals());
                    cancel.store(signal.is_err(), Ordering::Relaxed);
                }
            }
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    };
    let result = py.detach(|| watch(&mut signal));
    signal?;
    Ok(result?)
}
