//! One penalised design at every weight of its penalty, for little more than the price of one weight.
//!
//! With `W^1/2 A = Q T` and `[T; v Z] = [Q_T; Q_Z] R` for some v, and the singular value decomposition `Q_T = U C V^T`, the
//! columns of `Q_Z V` are orthogonal with lengths S, and `C^2 + S^2 = I`. At any weight w, the rows of the design in an
//! orthonormal basis of `[W^1/2 A; sqrt(w) Z]` are `Q U D`, up to a rotation that does not change the hat matrix, with
//! `D = C (C^2 + (w / v^2) S^2)^(-1/2)`. Cosines and sines are lengths of different rows, and where cosines are near one the
//! directions are those of the sines: both keep their digits near zero.

use std::ops::Range;

use crate::error::Error;
use crate::fit::factor::{Basis, Factor, Problem, weighted_responses};
use crate::fit::householder;
use crate::fit::linalg::{self, Svd};
use crate::fit::residuals::Residuals;
use crate::fit::survey::Survey;
use crate::pool::Pool;

/// A problem, factorised once for all weights of its penalty.
pub struct PenaltyPath {
    /// The v of the common factorisation, and a lower bound on the smallest singular value of `[W^1/2 A; v Z]` with columns
    /// at unit length; 0 without full rank.
    unit: f64,
    least: f64,
    /// Q U, rows x directions, row-major. Directions that the design does not see have coefficient zero at any weight, and
    /// are omitted.
    left: Vec<f64>,
    /// `(Q U)^T W^1/2 b`, directions x responses, column-major.
    projection: Vec<f64>,
    /// C, one a direction.
    cosines: Vec<f64>,
    /// S / v, one a direction.
    sines: Vec<f64>,
    /// `R^-1 V`, columns x directions, column-major.
    back: Vec<f64>,
    columns: Vec<Column>,
    /// What the rows of the design were.
    fingerprints: Vec<u64>,
}

/// A power of two, and the lengths of a column of the design and of the penalty that are multiplied by it.
struct Column {
    scale: f64,
    design: f64,
    penalty: f64,
}

impl PenaltyPath {
    /// Factorises the design, then what it has in common with the penalty.
    pub fn new(problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        let responses = problem.check()?;
        let (rows, width) = (problem.rows, problem.columns);
        let design = Problem { penalty: &[], ..*problem };
        // Of the design alone: in other units the penalty's entries are other multiples of the design's, and with them the
        // scales would round otherwise.
        let Survey { scales, fingerprints } = Survey::new(&design, pool)?;
        let (basis, triangle) = if rows > TALL * width {
            let alone = Problem { responses: &[], ..design };
            let Basis { rows, spectrum, .. } = Basis::new(&alone, &scales, alone.total_rows(), pool)?;
            (Some(rows), spectrum.rows())
        } else {
            (None, scaled_rows(problem, &scales, 0..rows))
        };
        let penalty = scaled_rows(problem, &scales, rows..problem.total_rows());
        let lengths = column_lengths(&triangle, width).into_iter().zip(column_lengths(&penalty, width));
        let column = |((design, penalty), &scale): ((f64, f64), &f64)| Column { scale, design, penalty };
        let columns: Vec<Column> = lengths.zip(&scales).map(column).collect();
        let Common { unit, least, turn, cosines, sines, mut back } =
            Common::new(&triangle, &penalty, &columns, pool)?;
        scale_rows(&mut back, &scales);
        let left = match basis {
            Some(basis) => turned(&basis, &turn, triangle.len() / width, cosines.len(), pool)?,
            None => linalg::transposed(&turn, rows),
        };
        let responses = (weighted_responses(&design, responses), responses);
        let projection = Residuals::projection(responses, (&left, cosines.len()), pool)?;
        Ok(Self { unit, least, left, projection, cosines, sines, back, columns, fingerprints })
    }

    /// Whether design and penalty together determine the coefficients.
    pub fn determined(&self) -> bool {
        self.least > 0.0
    }

    /// Rank of the design alone.
    pub fn rank(&self) -> usize {
        self.cosines.len()
    }

    /// The fit at a weight above zero, with coefficients of its basis, and those of the design (columns x responses,
    /// column-major). The penalty of the problem is that of the path times the root of the weight.
    pub fn fit(
        &self,
        problem: &Problem<'_>,
        weight: f64,
        pool: &Pool<'_>,
    ) -> Result<(Factor, Vec<f64>), Error> {
        let responses = problem.check()?;
        let (rank, root) = (self.rank(), weight.sqrt());
        let lengths: Vec<f64> =
            self.cosines.iter().zip(&self.sines).map(|(c, s)| c.hypot(root * s)).collect();
        let shares: Vec<f64> = self.cosines.iter().zip(&lengths).map(|(c, length)| c / length).collect();
        let mut basis = self.basis(&shares, pool)?;
        let penalty = basis[self.left.len()..].iter_mut().step_by(rank + 1);
        penalty.zip(&self.sines).zip(&lengths).for_each(|((x, s), length)| *x = root * s / length);
        // Rows of the problem tell rank from its loss, those of the basis only where no cosine is small.
        let whole = rank == problem.columns || self.full_rank_beyond_doubt(problem, root);
        let scales = whole.then(|| self.columns.iter().map(|column| column.unit(root)).collect());
        let mut fingerprints = self.fingerprints.clone();
        if whole {
            let penalty = problem.rows..problem.total_rows();
            fingerprints.extend(penalty.map(|i| problem.fingerprint(i, responses)));
        }
        let mut projection = self.projection.clone();
        scale_rows(&mut projection, &shares);
        let factor = Factor::orthonormal(problem, (basis, rank), projection, scales, fingerprints, pool)?;
        let mut along = factor.coefficients.clone();
        let inverses: Vec<f64> = lengths.iter().map(|length| length.recip()).collect();
        scale_rows(&mut along, &inverses);
        let coefficients = linalg::product(&self.back, &along, problem.columns, rank, responses);
        Ok((factor, coefficients))
    }

    /// Whether design and penalty together are of full rank to rounding at a weight, given its root: their smallest singular
    /// value, columns at unit length, falls at most by the ratio of the roots.
    fn full_rank_beyond_doubt(&self, problem: &Problem<'_>, root: f64) -> bool {
        let ratio = root / self.unit;
        let tolerance = problem.total_rows().max(problem.columns) as f64 * f64::EPSILON;
        self.least * ratio.min(ratio.recip()) > 2.0 * tolerance * (problem.columns as f64).sqrt()
    }

    /// `Q U D`, and rows of zeros for the penalty, as many as there are directions.
    fn basis(&self, shares: &[f64], pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        let rank = shares.len();
        let mut basis = vec![0.0; self.left.len() + rank * rank];
        let block = BLOCK_ROWS * rank.max(1);
        pool.run(
            basis[..self.left.len()].chunks_mut(block).zip(self.left.chunks(block)),
            || (),
            |(), (target, left)| {
                for (row, left) in target.chunks_exact_mut(rank).zip(left.chunks_exact(rank)) {
                    row.iter_mut().zip(left).zip(shares).for_each(|((x, u), d)| *x = u * d);
                }
            },
        )?;
        Ok(basis)
    }
}

impl Column {
    /// What brings the column to unit length at a weight, given its root.
    fn unit(&self, root: f64) -> f64 {
        let length = self.design.hypot(root * self.penalty);
        if length > 0.0 { self.scale / length } else { self.scale }
    }
}

/// The decomposition of what T, a design or its triangle, and a penalty Z have in common.
struct Common {
    /// What the penalty was multiplied by.
    unit: f64,
    /// A lower bound on the smallest singular value of both together, columns at unit length; 0 without full rank.
    least: f64,
    /// U, column-major.
    turn: Vec<f64>,
    cosines: Vec<f64>,
    sines: Vec<f64>,
    back: Vec<f64>,
}

impl Common {
    fn new(triangle: &[f64], penalty: &[f64], columns: &[Column], pool: &Pool<'_>) -> Result<Self, Error> {
        let (unit, columns) = (balance(columns), columns.len());
        let rows = triangle.len() / columns;
        let stacked: Vec<f64> = triangle.iter().copied().chain(penalty.iter().map(|z| unit * z)).collect();
        let total = stacked.len() / columns;
        let problem = Problem {
            design: &stacked,
            responses: &[],
            root_weights: None,
            penalty: &[],
            rows: total,
            columns,
        };
        // By reflections: from products of matrices, predictions at weights of 1e-7 had three digits less.
        let (basis, spectrum) =
            householder::orthonormal(&problem, &vec![1.0; columns], problem.total_rows(), pool)?;
        let width = spectrum.rank;
        let (above, below) = basis.split_at(rows * width);
        let mut svd = linalg::thin_svd(linalg::transposed(above, width), rows, width, pool)?;
        separate(&mut svd, below, (rows, width), pool)?;
        let Svd { u: mut turn, s: mut cosines, v: mut right } = svd;
        // Rounding, times the root of an extreme weight, would penalise directions without bending energy, and would pass
        // for rank.
        let rounding = (total + columns) as f64 * f64::EPSILON;
        cosines.truncate(cosines.partition_point(|&c| c > rounding));
        turn.truncate(rows * cosines.len());
        right.truncate(width * cosines.len());
        let sines = column_lengths(&turned(below, &right, width, cosines.len(), pool)?, cosines.len());
        let sines = sines.into_iter().map(|s| if s > rounding { s / unit } else { 0.0 }).collect();
        let mut back = vec![0.0; columns * cosines.len()];
        let parts =
            back.chunks_mut(columns * BLOCK_COLUMNS).zip(right.chunks((width * BLOCK_COLUMNS).max(1)));
        pool.run(
            parts,
            || (),
            |(), (part, right)| part.copy_from_slice(&spectrum.solve(right, right.len() / width)),
        )?;
        let least = if width == columns { spectrum.least } else { 0.0 };
        Ok(Self { unit, least, turn, cosines, sines, back })
    }
}

/// Cosines near one do not tell their directions apart, since sines that differ by decades have the same: the directions
/// of `Q_T` whose sines are small are turned until their rows of the penalty, `below`, are orthogonal.
fn separate(
    svd: &mut Svd,
    below: &[f64],
    (rows, width): (usize, usize),
    pool: &Pool<'_>,
) -> Result<(), Error> {
    let Svd { u, s, v } = svd;
    let soft = s.partition_point(|&c| 1.0 - c * c < SMALL_SINE * SMALL_SINE);
    let mut bent = turned(below, &v[..width * soft], width, soft, pool)?;
    // Directions without bending have a singular vector, too.
    let height = soft.max(below.len().checked_div(width).unwrap_or(0));
    bent.resize(height * soft, 0.0);
    let turn = linalg::thin_svd(linalg::transposed(&bent, soft), height, soft, pool)?.v;
    let right = linalg::product(&v[..width * soft], &turn, width, soft, soft);
    v[..width * soft].copy_from_slice(&right);
    for (column, cosine) in u.chunks_exact_mut(rows.max(1)).zip(&s[..soft]) {
        column.iter_mut().for_each(|x| *x *= cosine);
    }
    let left = linalg::product(&u[..rows * soft], &turn, rows, soft, soft);
    for ((to, from), cosine) in u.chunks_exact_mut(rows.max(1)).zip(left.chunks_exact(rows.max(1))).zip(s) {
        *cosine = linalg::dot(from, from).sqrt();
        to.iter_mut().zip(from).for_each(|(to, x)| *to = x / *cosine);
    }
    Ok(())
}

/// A sine above this has lost less than a digit to the cosine.
const SMALL_SINE: f64 = 0.1;

/// Columns of the design that are this much shorter, beside those of the penalty, than the longest one, are rounding: control
/// points without data.
const UNSEEN: f64 = 1e-10;

/// A power of two by which columns of the penalty become about as long as those of the design, in the geometric mean: what
/// is soft and what is stiff then lose the same digits, and units of columns do not matter.
fn balance(columns: &[Column]) -> f64 {
    let ratios = || columns.iter().map(|c| c.design / c.penalty).filter(|ratio| ratio.is_normal());
    let largest = ratios().fold(0.0, f64::max);
    let logarithms: Vec<f64> = ratios().filter(|&ratio| ratio > UNSEEN * largest).map(f64::log2).collect();
    let mean = logarithms.iter().sum::<f64>() / logarithms.len().max(1) as f64;
    // Entries of other columns must not overflow.
    mean.round().clamp(-400.0, 400.0).exp2()
}

/// Designs of more rows than this times their columns are reduced to a triangle first.
const TALL: usize = 2;

/// Rows of `[W^1/2 A; Z]`, columns multiplied by their scales.
fn scaled_rows(problem: &Problem<'_>, scales: &[f64], rows: Range<usize>) -> Vec<f64> {
    let scaled = |i| {
        let (row, weight) = problem.row(i);
        row.iter().zip(scales).map(move |(a, scale)| a * scale * weight)
    };
    rows.flat_map(scaled).collect()
}

/// Rows of a block of the basis.
const BLOCK_ROWS: usize = 256;

/// Columns of a block of solutions.
const BLOCK_COLUMNS: usize = 64;

/// A row-major matrix times a column-major one (inner x width), row-major.
fn turned(
    matrix: &[f64],
    turn: &[f64],
    inner: usize,
    width: usize,
    pool: &Pool<'_>,
) -> Result<Vec<f64>, Error> {
    let rows = matrix.len().checked_div(inner).unwrap_or(0);
    linalg::product_in_blocks(&linalg::transposed(turn, inner), matrix, (width, inner, rows), pool)
}

/// Multiplies every row of a column-major matrix by its scale.
fn scale_rows(matrix: &mut [f64], scales: &[f64]) {
    for column in matrix.chunks_exact_mut(scales.len().max(1)) {
        column.iter_mut().zip(scales).for_each(|(x, scale)| *x *= scale);
    }
}

/// Lengths of the columns of a row-major matrix.
fn column_lengths(matrix: &[f64], columns: usize) -> Vec<f64> {
    let mut squares = vec![0.0; columns];
    for row in matrix.chunks_exact(columns.max(1)) {
        squares.iter_mut().zip(row).for_each(|(square, x)| *square += x * x);
    }
    squares.into_iter().map(f64::sqrt).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    const RESPONSES: usize = 2;

    /// The arrays of a problem with weights; columns of the penalty and, if asked for, of the design depend on others.
    struct Made {
        design: Vec<f64>,
        responses: Vec<f64>,
        root_weights: Vec<f64>,
        penalty: Vec<f64>,
        rows: usize,
        columns: usize,
    }

    impl Made {
        fn new(rows: usize, columns: usize, penalties: usize, dependent: bool) -> Self {
            let entry = |i: usize| ((i * 7919 + i * i % 977) % 1000) as f64 / 500.0 - 1.0;
            let some = |size: usize, from: usize| (from..from + size).map(entry).collect::<Vec<_>>();
            let mut design = some(rows * columns, 3);
            if dependent {
                for row in design.chunks_exact_mut(columns) {
                    row[1] = 2.0 * row[0];
                }
            }
            let root_weights = some(rows, 70).into_iter().map(|x| 1.5 + x).collect();
            let (responses, penalty) = (some(rows * RESPONSES, 11), some(penalties * columns, 500));
            Self { design, responses, root_weights, penalty, rows, columns }
        }

        fn problem<'a>(&'a self, penalty: &'a [f64]) -> Problem<'a> {
            Problem {
                design: &self.design,
                responses: &self.responses,
                root_weights: Some(&self.root_weights),
                penalty,
                rows: self.rows,
                columns: self.columns,
            }
        }

        /// The penalty times the root of a weight.
        fn weighted(&self, weight: f64) -> Vec<f64> {
            self.penalty.iter().map(|z| weight.sqrt() * z).collect()
        }
    }

    fn assert_close(given: &[f64], expected: &[f64], what: &str) {
        let size = expected.iter().fold(1.0_f64, |size, x| size.max(x.abs()));
        assert_eq!(given.len(), expected.len(), "{what}");
        for (x, y) in given.iter().zip(expected) {
            assert!((x - y).abs() < 1e-10 * size, "{what}: {x} for {y}");
        }
    }

    #[test]
    fn every_weight_is_a_factorisation_of_its_own() {
        let never = AtomicBool::new(false);
        let pool = Pool::new(2, &never);
        for (rows, columns, penalties, dependent, rank) in
            [(30, 6, 4, false, 6), (5000, 7, 9, false, 7), (10, 15, 20, false, 10), (30, 6, 6, true, 5)]
        {
            let made = Made::new(rows, columns, penalties, dependent);
            let path = PenaltyPath::new(&made.problem(&made.penalty), &pool).unwrap();
            assert!(path.determined());
            assert_eq!(path.rank(), rank);
            for weight in [1e-3, 1.0, 1e6] {
                let penalty = made.weighted(weight);
                let problem = made.problem(&penalty);
                let (factor, coefficients) = path.fit(&problem, weight, &pool).unwrap();
                let direct = Factor::new(&problem, &pool).unwrap();
                let what = format!("{rows} x {columns}, weight {weight}");
                assert_close(&factor.plain_residuals(), &direct.plain_residuals(), &what);
                assert_close(&factor.leverage, &direct.leverage, &what);
                assert_close(&coefficients, &direct.coefficients, &what);
                assert_eq!(factor.rank, rank);
            }
        }
    }

    #[test]
    fn threads_change_no_bit() {
        let never = AtomicBool::new(false);
        let made = Made::new(5000, 40, 30, false);
        let found = [1, 2, 5].map(|threads| {
            let pool = Pool::new(threads, &never);
            let path = PenaltyPath::new(&made.problem(&made.penalty), &pool).unwrap();
            let (factor, coefficients) = path.fit(&made.problem(&made.penalty), 1.0, &pool).unwrap();
            (factor.basis, factor.leverage, coefficients)
        });
        assert!(found.iter().all(|same| *same == found[0]));
    }

    #[test]
    fn a_penalty_may_be_none_and_a_design_zero() {
        let never = AtomicBool::new(false);
        let pool = Pool::new(1, &never);
        let mut made = Made::new(20, 4, 5, false);
        made.penalty.fill(0.0);
        let path = PenaltyPath::new(&made.problem(&made.penalty), &pool).unwrap();
        let (factor, _) = path.fit(&made.problem(&made.penalty), 1e9, &pool).unwrap();
        assert!((factor.leverage.iter().sum::<f64>() - 4.0).abs() < 1e-12);
        let mut made = Made::new(20, 4, 5, false);
        made.design.fill(0.0);
        let path = PenaltyPath::new(&made.problem(&made.penalty), &pool).unwrap();
        assert!(path.determined());
        let (factor, coefficients) = path.fit(&made.problem(&made.penalty), 1.0, &pool).unwrap();
        assert_eq!((factor.rank, coefficients), (0, vec![0.0; 4 * RESPONSES]));
        assert_eq!(factor.leverage, vec![0.0; 20]);
    }

    #[test]
    fn what_neither_sees_is_not_determined() {
        let never = AtomicBool::new(false);
        let made = Made::new(20, 6, 0, true);
        let path = PenaltyPath::new(&made.problem(&made.penalty), &Pool::new(1, &never)).unwrap();
        assert_eq!((path.determined(), path.rank()), (false, 5));
    }
}
