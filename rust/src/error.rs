//! What can go wrong, with numbers in the variants.

use std::fmt;

/// A failure of the crate. Hard but valid data (rank loss) are never failures: results report them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// The caller asked to stop.
    Interrupted,
    /// Two lengths that must agree do not.
    Length {
        /// What the other arguments imply.
        expected: usize,
        /// What came.
        given: usize,
    },
    /// An index points outside what it indexes.
    Index {
        /// The offending index.
        index: usize,
        /// Indices must be below this.
        bound: usize,
    },
    /// Numbers that must not decrease do.
    Decreasing {
        /// The first that is less than the one before it.
        index: usize,
    },
    /// A number that must be finite is not.
    NotFinite {
        /// Its place in the slice.
        index: usize,
    },
    /// Neighbourhoods have more members than memory should hold.
    TooMany {
        /// The most there may be.
        most: usize,
    },
    /// Points of a dimension that the search trees are not built for.
    Dimension {
        /// Coordinates per point.
        given: usize,
    },
    /// The problem is not the one that was factored.
    Changed {
        /// A row that is no longer what it was.
        row: usize,
    },
    /// Three points that must span a triangle are on a line.
    Collinear {
        /// Their indices.
        first: [usize; 3],
    },
    /// A singular value decomposition did not converge.
    NoConvergence,
    /// Control points are so near each other that their splines are not determined.
    TooNear,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Interrupted => write!(f, "interrupted"),
            Self::Length { expected, given } => write!(f, "length {given} where {expected} was expected"),
            Self::Index { index, bound } => write!(f, "index {index} is not below {bound}"),
            Self::Decreasing { index } => write!(f, "number {index} is less than the one before"),
            Self::NotFinite { index } => write!(f, "number {index} is not finite"),
            Self::TooMany { most } => write!(f, "more than {most} neighbours in all"),
            Self::Dimension { given } => write!(f, "points have {given} coordinates"),
            Self::Changed { row } => write!(f, "row {row} has changed since the factorisation"),
            Self::Collinear { first: [a, b, c] } => write!(f, "points {a}, {b} and {c} are on a line"),
            Self::TooNear => write!(f, "control points are too near each other"),
            Self::NoConvergence => write!(f, "the singular value decomposition did not converge"),
        }
    }
}

impl std::error::Error for Error {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_say_the_numbers() {
        let length = Error::Length { expected: 12, given: 7 }.to_string();
        assert!(length.contains("12") && length.contains('7'));
        let line = Error::Collinear { first: [4, 8, 15] }.to_string();
        assert!(["4", "8", "15"].iter().all(|index| line.contains(index)));
        assert_eq!(Error::Changed { row: 3 }.to_string(), "row 3 has changed since the factorisation");
    }
}
