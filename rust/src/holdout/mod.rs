//! What is held out: pairs of sets and their predictions, of one model or of all leading ones.

mod dual;
pub mod gram;
mod hat;
pub mod kernel;
pub mod nested;
mod plan;
mod probes;
pub mod rescue;
pub mod residuals;
pub mod scheme;
pub mod score;
mod spread;
mod walk;
