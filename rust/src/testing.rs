//! What the tests of several modules share: problems, and the refit that closed forms are compared with.

use std::ops::{Add, Div, Mul, Sub};
use std::sync::atomic::AtomicBool;

use crate::fit::factor::{Factor, Problem};
use crate::pool::Pool;
use crate::sets::Sets;

static NEVER: AtomicBool = AtomicBool::new(false);

/// Threads that nobody calls off.
pub(crate) fn pool(threads: usize) -> Pool<'static> {
    Pool::new(threads, &NEVER)
}

/// Numbers between -1 and 1 that no structure shows in.
pub(crate) fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

pub(crate) fn sets<const N: usize>(sets: [&[usize]; N]) -> Sets<'static> {
    sets.into_iter().map(<[usize]>::to_vec).collect()
}

/// Each of `count` data alone.
pub(crate) fn singletons(count: usize) -> Sets<'static> {
    (0..count).map(|i| vec![i]).collect()
}

/// Around each of `count` data on a line, those within a distance: balls that nest.
pub(crate) fn windows(count: usize, reach: usize) -> Sets<'static> {
    (0..count).map(|i| (i.saturating_sub(reach)..count.min(i + reach + 1)).collect()).collect()
}

pub(crate) fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|x| x.to_bits()).collect()
}

/// Fails unless numbers agree to this part of the largest, or are not defined alike.
pub(crate) fn assert_close(given: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(given.len(), expected.len());
    let size = expected.iter().fold(0.0, |size: f64, x| size.max(x.abs()));
    for (k, (a, b)) in given.iter().zip(expected).enumerate() {
        let same = a.is_nan() && b.is_nan() || (a - b).abs() <= tolerance * size;
        assert!(same, "number {k}: {a} is not {b}");
    }
}

/// A weighted, penalised problem.
#[derive(Clone)]
pub(crate) struct Example {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    pub(crate) count: usize,
    pub(crate) design: Vec<f64>,
    pub(crate) responses: Vec<f64>,
    /// Powers of two, which cost no digit.
    pub(crate) root_weights: Vec<f64>,
    pub(crate) penalty: Vec<f64>,
}

impl Example {
    /// With `count` responses and two penalty rows.
    pub(crate) fn new(rows: usize, columns: usize, count: usize) -> Self {
        Self {
            rows,
            columns,
            count,
            design: noise(rows * columns, 1),
            responses: noise(rows * count, 2),
            root_weights: (0..rows).map(|i| [1.0, 2.0, 0.5][i % 3]).collect(),
            penalty: noise(2 * columns, 3),
        }
    }

    /// The last column is seen by the last two rows, and by all others at a fraction of its length.
    pub(crate) fn nearly_lost(rows: usize, columns: usize, fraction: f64) -> Self {
        let mut example = Self::new(rows, columns, 2);
        example.penalty.clear();
        for row in example.design.chunks_exact_mut(columns).take(rows - 2) {
            row[columns - 1] *= fraction;
        }
        example
    }

    pub(crate) fn problem(&self) -> Problem<'_> {
        Problem {
            design: &self.design,
            responses: &self.responses,
            root_weights: Some(&self.root_weights),
            penalty: &self.penalty,
            rows: self.rows,
            columns: self.columns,
        }
    }

    pub(crate) fn factor(&self) -> Factor {
        Factor::new(&self.problem(), &pool(1)).unwrap()
    }

    /// The model of the first columns.
    pub(crate) fn lead(&self, size: usize) -> Self {
        let cut = |matrix: &[f64]| matrix.chunks(self.columns).flat_map(|row| row[..size].to_vec()).collect();
        Self { columns: size, design: cut(&self.design), penalty: cut(&self.penalty), ..self.clone() }
    }

    /// Residuals of rows, row-major, under the plain fit of all rows but those held out: by normal equations with twice
    /// the digits. Not numbers if that has lost rank.
    pub(crate) fn refit(&self, held: &[usize], rows: &[usize]) -> Vec<f64> {
        let p = self.columns;
        let weighted = |i: usize| {
            let w = self.root_weights[i];
            let entries = self.design[i * p..(i + 1) * p].iter();
            let right = self.responses[i * self.count..(i + 1) * self.count].iter();
            entries.chain(right).map(|x| x * w).collect::<Vec<f64>>()
        };
        let penalised = |row: &[f64]| {
            let mut row = row.to_vec();
            row.resize(p + self.count, 0.0);
            row
        };
        let mut system = vec![vec![Exact::default(); p + self.count]; p];
        let training = (0..self.rows).filter(|i| !held.contains(i)).map(weighted);
        for row in training.chain(self.penalty.chunks(p).map(penalised)) {
            for (equation, x) in system.iter_mut().zip(&row) {
                for (sum, y) in equation.iter_mut().zip(&row) {
                    *sum = *sum + Exact::from(*x) * Exact::from(*y);
                }
            }
        }
        let solution = solve(system);
        let residual = |i: usize, c: usize| match &solution {
            None => f64::NAN,
            Some(x) => {
                let b = Exact::from(self.responses[i * self.count + c]);
                let entries = self.design[i * p..(i + 1) * p].iter().zip(x);
                entries.fold(b, |rest, (&a, x)| rest - Exact::from(a) * x[c]).hi
            }
        };
        rows.iter().flat_map(|&i| (0..self.count).map(move |c| (i, c))).map(|(i, c)| residual(i, c)).collect()
    }
}

/// The solutions of a positive definite system, right-hand sides behind its matrix; None if that is singular.
fn solve(mut system: Vec<Vec<Exact>>) -> Option<Vec<Vec<Exact>>> {
    let order = system.len();
    let whole: Vec<f64> = (0..order).map(|k| system[k][k].hi).collect();
    for k in 0..order {
        let pivots = system[k].clone();
        if pivots[k].hi <= 1e-26 * whole[k] {
            return None;
        }
        for (_, row) in system.iter_mut().enumerate().filter(|&(i, _)| i != k) {
            let factor = row[k] / pivots[k];
            row.iter_mut().zip(&pivots).for_each(|(x, pivot)| *x = *x - factor * *pivot);
        }
    }
    Some(
        system
            .iter()
            .enumerate()
            .map(|(k, row)| row[order..].iter().map(|x| *x / row[k]).collect())
            .collect(),
    )
}

/// A number with twice the digits, hi + lo, as in Dekker (1971).
#[derive(Clone, Copy, Default)]
struct Exact {
    hi: f64,
    lo: f64,
}

impl Exact {
    /// Of a sum whose first term is the larger.
    fn new(hi: f64, lo: f64) -> Self {
        let sum = hi + lo;
        Self { hi: sum, lo: lo - (sum - hi) }
    }
}

impl From<f64> for Exact {
    fn from(hi: f64) -> Self {
        Self { hi, lo: 0.0 }
    }
}

impl Add for Exact {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let sum = self.hi + other.hi;
        let back = sum - self.hi;
        Self::new(sum, (self.hi - (sum - back)) + (other.hi - back) + self.lo + other.lo)
    }
}

impl Sub for Exact {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + Self { hi: -other.hi, lo: -other.lo }
    }
}

impl Mul for Exact {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let product = self.hi * other.hi;
        Self::new(product, self.hi.mul_add(other.hi, -product) + self.hi * other.lo + self.lo * other.hi)
    }
}

impl Div for Exact {
    type Output = Self;

    fn div(self, other: Self) -> Self {
        let guess = Self::from(self.hi / other.hi);
        guess + Self::from((self - guess * other).hi / other.hi)
    }
}

#[test]
fn a_refit_has_twice_the_digits() {
    // Through two points that are 2^-24 apart: their slope is 2^24.
    let e = (-24.0_f64).exp2();
    let example = Example {
        rows: 4,
        columns: 2,
        count: 1,
        design: vec![1.0, 0.0, 1.0, 1.0, 1.0, 1.0 + e, 1.0, 3.0],
        responses: vec![7.0, 1.0, 2.0, 0.0],
        root_weights: vec![1.0, 2.0, 1.0, 1.0],
        penalty: Vec::new(),
    };
    assert_close(&example.refit(&[0, 3], &[1, 2, 3]), &[0.0, 0.0, -1.0 - 2.0 / e], 1e-15);
    assert!(example.refit(&[0, 1, 3], &[0])[0].is_nan());
}
