//! What is held out: pairs of sets and their predictions, of one model or of all leading ones.

mod dual;
pub mod gram;
pub mod kernel;
pub mod nested;
pub mod pairs;
mod primal;
mod probes;
pub mod rescue;
mod visit;
