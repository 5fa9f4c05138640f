//! The mathematics as properties, checked on random problems.

use std::sync::atomic::AtomicBool;

use mexpress::error::Error;
use mexpress::fit::factor::{Factor, Problem};
use mexpress::holdout::nested::{Curve, Nested};
use mexpress::holdout::residuals::{Predictions, Status};
use mexpress::holdout::scheme::{Held, Scheme};
use mexpress::near::neighbours::LazyNeighbourhoods;
use mexpress::pool::Pool;
use mexpress::sets::Sets;
use proptest::prelude::*;

static NEVER: AtomicBool = AtomicBool::new(false);

fn pool(threads: usize) -> Pool<'static> {
    Pool::new(threads, &NEVER)
}

/// A random weighted, penalised problem.
#[derive(Clone, Debug)]
struct Case {
    rows: usize,
    columns: usize,
    responses: usize,
    design: Vec<f64>,
    targets: Vec<f64>,
    weights: Vec<f64>,
    penalty: Vec<f64>,
}

impl Case {
    fn fit(&self) -> Factor {
        self.fit_on(2)
    }

    fn fit_on(&self, threads: usize) -> Factor {
        self.with_problem(|problem| Factor::new(problem, &pool(threads)).unwrap())
    }

    fn with_problem<T>(&self, use_it: impl FnOnce(&Problem<'_>) -> T) -> T {
        let roots: Vec<f64> = self.weights.iter().map(|w| w.sqrt()).collect();
        use_it(&Problem {
            design: &self.design,
            responses: &self.targets,
            root_weights: Some(&roots),
            penalty: &self.penalty,
            rows: self.rows,
            columns: self.columns,
        })
    }

    fn predict(&self, fit: &Factor, held: &Sets, validated: &Sets, threads: usize) -> Predictions {
        let rows = singles(fit.rows);
        let scheme = Scheme { held: Held::Sets(held), validated, order: None };
        self.with_problem(|problem| fit.predict(problem, &[scheme], &rows, &pool(threads)).unwrap())
    }

    fn keep(&self, rows: &[usize]) -> Self {
        let pick = |values: &[f64], width: usize| {
            rows.iter().flat_map(|&i| values[i * width..(i + 1) * width].to_vec()).collect::<Vec<_>>()
        };
        Self {
            rows: rows.len(),
            design: pick(&self.design, self.columns),
            targets: pick(&self.targets, self.responses),
            weights: pick(&self.weights, 1),
            ..self.clone()
        }
    }

    /// The model of the first columns.
    fn lead(&self, size: usize) -> Self {
        let cut =
            |matrix: &[f64]| matrix.chunks_exact(self.columns).flat_map(|row| row[..size].to_vec()).collect();
        Self { columns: size, design: cut(&self.design), penalty: cut(&self.penalty), ..self.clone() }
    }

    /// What every leading model says of a scheme.
    fn curves(&self, schemes: &[Scheme<'_>], threads: usize) -> Vec<Curve> {
        let sizes: Vec<usize> = (1..=self.columns).collect();
        self.with_problem(|problem| {
            let nested = Nested::new(problem, &pool(threads)).unwrap();
            nested.curves(problem, schemes, &singles(self.rows), &sizes, &pool(threads)).unwrap()
        })
    }

    /// The same by a refit of every leading model for every pair: sums of squares, and how many models each pair defines.
    fn refitted_curve(&self, held: &Sets, validated: &Sets) -> (Vec<f64>, Vec<usize>) {
        let (mut squares, mut defined) = (vec![0.0; self.columns], vec![self.columns; held.len()]);
        let models: Vec<(Self, Factor)> =
            (1..=self.columns).map(|size| self.lead(size)).map(|m| (m.clone(), m.fit())).collect();
        for (pair, defined) in defined.iter_mut().enumerate() {
            let training: Vec<usize> = (0..self.rows).filter(|i| !held.get(pair).contains(i)).collect();
            for (k, (model, fit)) in models.iter().enumerate() {
                let refit = model.keep(&training).fit();
                if refit.rank < fit.rank {
                    *defined = k.min(*defined);
                    squares[k] = f64::NAN;
                    continue;
                }
                let residuals = model.residuals(&refit, validated.get(pair));
                for (e, &i) in residuals.chunks_exact(self.responses).zip(validated.get(pair)) {
                    squares[k] += self.weights[i] * e.iter().map(|e| e * e).sum::<f64>();
                }
            }
        }
        (squares, defined)
    }

    /// Fails unless a scheme's curve is that of refits, relative to the responses or the curve.
    fn assert_refits(&self, curve: &Curve, held: &Sets, validated: &Sets, tolerance: f64) {
        let (squares, defined) = self.refitted_curve(held, validated);
        let scale: f64 = self
            .targets
            .chunks_exact(self.responses)
            .zip(&self.weights)
            .map(|(b, w)| w * b.iter().map(|b| b * b).sum::<f64>())
            .sum();
        assert_eq!(curve.defined, defined);
        for (ours, plain) in curve.squares.iter().zip(&squares) {
            assert_eq!(ours.is_nan(), plain.is_nan());
            assert!(plain.is_nan() || (ours - plain).abs() <= tolerance * plain.max(scale), "{ours} {plain}");
        }
    }

    /// Residuals of `rows` under the coefficients of `fit`.
    fn residuals(&self, fit: &Factor, rows: &[usize]) -> Vec<f64> {
        let residual = |i: usize, c: usize| {
            let a = &self.design[i * self.columns..(i + 1) * self.columns];
            let x = &fit.coefficients[c * self.columns..(c + 1) * self.columns];
            self.targets[i * self.responses + c] - a.iter().zip(x).map(|(a, x)| a * x).sum::<f64>()
        };
        rows.iter().flat_map(|&i| (0..self.responses).map(move |c| residual(i, c))).collect()
    }
}

fn cases() -> impl Strategy<Value = Case> {
    (1usize..14, 2usize..40, 1usize..4, 0usize..6).prop_flat_map(|(columns, extra, responses, penalties)| {
        let rows = columns + extra;
        let entries = |count| prop::collection::vec(-1.0..1.0f64, count);
        (
            entries(rows * columns),
            entries(rows * responses),
            prop::collection::vec(0.1..5.0f64, rows),
            entries(penalties * columns),
        )
            .prop_map(move |(design, targets, weights, penalty)| Case {
                rows,
                columns,
                responses,
                design,
                targets,
                weights,
                penalty,
            })
    })
}

fn singles(n: usize) -> Sets<'static> {
    (0..n).map(|i| vec![i]).collect()
}

fn close(a: &[f64], b: &[f64], tolerance: f64) -> bool {
    let size = b.iter().fold(1.0, |m: f64, x| m.max(x.abs()));
    a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() <= tolerance * size)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

    #[test]
    fn the_hat_matrix_is_a_projection(case in cases()) {
        let plain = Case { penalty: Vec::new(), ..case };
        let fit = plain.fit();
        let m = fit.rows;
        let h = fit.hat_blocks(&[(0..m).collect()].into_iter().collect(), &pool(2)).unwrap();
        let square: Vec<f64> = (0..m * m)
            .map(|k| (0..m).map(|t| h[k / m * m + t] * h[t * m + k % m]).sum())
            .collect();
        prop_assert!(close(&square, &h, 1e-13));
        // H maps the weighted responses to the weighted fit, and is symmetric: so does its transpose.
        let root = |i: usize| plain.weights[i].sqrt();
        let residuals = fit.plain_residuals();
        for c in 0..fit.responses {
            let at = |i: usize| i * fit.responses + c;
            for i in 0..m {
                let fitted = (plain.targets[at(i)] - residuals[at(i)]) * root(i);
                let mapped: f64 = (0..m).map(|t| h[t * m + i] * plain.targets[at(t)] * root(t)).sum();
                prop_assert!((mapped - fitted).abs() < 1e-12);
            }
        }
        let trace: f64 = (0..m).map(|i| h[i * m + i]).sum();
        prop_assert!((trace - fit.rank as f64).abs() < 1e-12);
        prop_assert!(close(&fit.leverage, &(0..m).map(|i| h[i * m + i]).collect::<Vec<_>>(), 1e-15));
    }

    /// The closed form against the refit that it replaces, for sets on both sides of every method's limits.
    #[test]
    fn predictions_are_refits(case in cases(), seed in any::<u64>(), size in 1usize..20) {
        let fit = case.fit();
        let mut order: Vec<usize> = (0..case.rows).collect();
        order.sort_by_key(|&i| (i as u64 + 1).wrapping_mul(seed | 1));
        let size = size.min(case.rows - 1);
        let (mut held, training) = (order[..size].to_vec(), &order[size..]);
        held.sort_unstable();
        let validated: Vec<usize> = held.iter().copied().step_by(2).collect();
        let refit = case.keep(training).fit();
        let found = case.predict(&fit, &[held].into_iter().collect(), &[validated.clone()].into_iter().collect(), 1);
        prop_assert_eq!(found.status[0] == Status::Undefined, refit.rank < fit.rank);
        if refit.rank == fit.rank && fit.rank == case.columns {
            // Both sides carry the conditioning of the training rows.
            let least = refit.coefficients.iter().fold(1.0, |m: f64, x| m.max(x.abs()));
            prop_assert!(close(&found.residuals, &case.residuals(&refit, &validated), 1e-11 * least));
        }
        prop_assert_eq!(found.rows, validated);
    }

    /// Of all that is held out it is the inverse of I - H_KK, on both sides of the dual's limit; of some, its part.
    #[test]
    fn spreads_invert_what_is_left_of_the_hat_matrix(case in cases(), seed in any::<u64>(), size in 1usize..20) {
        let fit = case.fit();
        let mut held: Vec<usize> = (0..case.rows).collect();
        held.sort_by_key(|&i| (i as u64 + 1).wrapping_mul(seed | 1));
        held.truncate(size.min(case.rows - 1));
        held.sort_unstable();
        let q = held.len();
        let validated: Vec<usize> = held.iter().copied().step_by(2).collect();
        let t = validated.len();
        let (k, some): (Sets, Sets) = ([held.clone()].into_iter().collect(), [validated].into_iter().collect());
        let rows = singles(case.rows);
        let spread = |validated: &Sets, threads| {
            let scheme = Scheme { held: Held::Sets(&k), validated, order: None };
            case.with_problem(|problem| fit.spread(problem, &scheme, &rows, &pool(threads)).unwrap())
        };
        let (whole, part) = (spread(&k, 1), spread(&some, 2));
        let h = fit.hat_blocks(&k, &pool(1)).unwrap();
        let largest = whole.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        let lost = case.predict(&fit, &k, &k, 1).status[0] == Status::Undefined;
        prop_assert_eq!(whole.iter().map(|x| x.is_nan()).collect::<Vec<_>>(), vec![lost; q * q]);
        if largest < 1e8 && !lost {
            for i in 0..q {
                for j in 0..q {
                    let one = |i, j| if i == j { 1.0 } else { 0.0 };
                    let sum: f64 = (0..q).map(|l| (one(i, l) - h[i * q + l]) * whole[l * q + j]).sum();
                    prop_assert!((sum - one(i, j)).abs() < 1e-12 * (1.0 + largest));
                }
            }
            let picked: Vec<f64> = (0..t * t).map(|at| whole[2 * (at / t) * q + 2 * (at % t)]).collect();
            prop_assert!(close(&part, &picked, 1e-12 * largest));
        }
    }

    /// Single rows, windows that are listed or found when needed, and sets of any size: the dual, the primal, and chains.
    #[test]
    fn leading_models_are_refits(case in cases(), seed in any::<u64>(), size in 1usize..20) {
        let n = case.rows;
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by_key(|&i| (i as u64 + 1).wrapping_mul(seed | 1));
        let mut some = order[..size.min(n - 1)].to_vec();
        some.sort_unstable();
        let reach = 2.min(n / 2 - 1);
        let windows: Sets = (0..n).map(|i| (i.saturating_sub(reach)..n.min(i + reach + 1)).collect()).collect();
        let places: Vec<f64> = (0..n).map(|i| i as f64).collect();
        let lazy = LazyNeighbourhoods::within(&places, 1, reach as f64, &pool(1)).unwrap();
        let (alone, every): (Sets, Vec<usize>) = (singles(n), (0..n).collect());
        let (one, part): (Sets, Sets) = ([some.clone()].into_iter().collect(), [some[..some.len().div_ceil(2)].to_vec()].into_iter().collect());
        let schemes = [
            Scheme { held: Held::Sets(&windows), validated: &alone, order: Some(&every) },
            Scheme { held: Held::Sets(&alone), validated: &alone, order: Some(&every) },
            Scheme { held: Held::Lazy(&lazy), validated: &lazy.singletons, order: Some(&every) },
            Scheme { held: Held::Sets(&one), validated: &part, order: Some(&[0]) },
        ];
        let curves = case.curves(&schemes, 2);
        for (curve, (held, validated)) in curves.iter().zip([(&windows, &alone), (&alone, &alone), (&windows, &alone), (&one, &part)]) {
            case.assert_refits(curve, held, validated, 1e-8);
        }
    }

    #[test]
    fn rows_may_come_in_any_order(case in cases()) {
        let reversed: Vec<usize> = (0..case.rows).rev().collect();
        let (fit, turned) = (case.fit(), case.keep(&reversed).fit());
        prop_assert!(close(&turned.coefficients, &fit.coefficients, 1e-9));
        let there = case.predict(&fit, &singles(case.rows), &singles(case.rows), 1);
        let back = case.keep(&reversed).predict(&turned, &singles(case.rows), &singles(case.rows), 1);
        for i in 0..case.rows {
            let (r, j) = (case.responses, case.rows - 1 - i);
            if there.status[i] == Status::Closed {
                prop_assert!(close(&back.residuals[j * r..(j + 1) * r], &there.residuals[i * r..(i + 1) * r], 1e-9));
            }
        }
        let leverage: Vec<f64> = turned.leverage.iter().rev().copied().collect();
        prop_assert!(close(&leverage, &fit.leverage, 1e-12));
    }

    #[test]
    fn columns_may_have_any_scale(case in cases(), powers in prop::collection::vec(-120i32..120, 14)) {
        let mut scaled = case.clone();
        let scale = |x: &mut Vec<f64>| {
            x.iter_mut().enumerate().for_each(|(k, x)| *x *= 10f64.powi(powers[k % case.columns]));
        };
        scale(&mut scaled.design);
        scale(&mut scaled.penalty);
        let (fit, other) = (case.fit(), scaled.fit());
        prop_assert_eq!(fit.rank, other.rank);
        prop_assert!(close(&other.leverage, &fit.leverage, 1e-11));
        prop_assert!(close(&other.plain_residuals(), &fit.plain_residuals(), 1e-10));
    }

    #[test]
    fn weights_are_replication(case in cases(), counts in prop::collection::vec(1usize..4, 60)) {
        let whole = Case { weights: (0..case.rows).map(|i| counts[i] as f64).collect(), ..case };
        let copies: Vec<usize> = (0..whole.rows).flat_map(|i| vec![i; counts[i]]).collect();
        let mut replicated = whole.keep(&copies);
        replicated.weights.fill(1.0);
        let (fit, other) = (whole.fit(), replicated.fit());
        prop_assert!(close(&other.coefficients, &fit.coefficients, 1e-9));
        let held: Sets = (0..whole.rows).map(|i| (0..copies.len()).filter(|&k| copies[k] == i).collect()).collect();
        let (one, many) = (whole.predict(&fit, &singles(whole.rows), &singles(whole.rows), 1), replicated.predict(&other, &held, &held, 1));
        for i in 0..whole.rows {
            if one.status[i] == Status::Closed {
                let r = whole.responses;
                prop_assert!(close(
                    &many.residuals[many.offsets[i] * r..(many.offsets[i] + 1) * r],
                    &one.residuals[i * r..(i + 1) * r],
                    1e-8,
                ));
            }
        }
    }

    #[test]
    fn threads_change_no_bit(case in cases()) {
        let fits = [1, 2, 3].map(|t| case.fit_on(t));
        let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let held: Sets = (0..case.rows).map(|i| (i..case.rows.min(i + 4)).collect()).collect();
        let found = fits.each_ref().map(|f| bits(&case.predict(f, &held, &singles(case.rows), 3).residuals));
        for k in 1..3 {
            prop_assert_eq!(bits(&fits[0].basis), bits(&fits[k].basis));
            prop_assert_eq!(&found[0], &found[k]);
        }
    }
}

/// A column that the training rows see at a fraction of its length, and weights that count whatever becomes of the pair.
#[test]
fn pairs_near_rank_loss_are_refits_too() {
    let ways =
        [(1.0, Status::Closed), (4e-4, Status::Refined), (1e-7, Status::Refitted), (0.0, Status::Undefined)];
    for (fraction, status) in ways {
        let second = |i: usize| [1.0, -2.0].get(i.wrapping_sub(18)).copied().unwrap_or(fraction * entry(i));
        let case = Case {
            rows: 20,
            columns: 2,
            responses: 2,
            design: (0..20).flat_map(|i| [1.0, second(i)]).collect(),
            targets: (0..40).map(|k| entry(k + 50)).collect(),
            weights: (0..20).map(|i| 0.1 + 5.0 * (1.0 + entry(i + 100))).collect(),
            penalty: Vec::new(),
        };
        let held: Sets = [vec![18, 19], vec![3, 18, 19], (3..20).collect()].into_iter().collect();
        let found = case.predict(&case.fit(), &held, &held, 1);
        assert_eq!(found.status, [status; 3]);
        for pair in 0..3 {
            let out = &found.residuals[2 * found.offsets[pair]..2 * found.offsets[pair + 1]];
            let training: Vec<usize> = (0..20).filter(|i| !held.get(pair).contains(i)).collect();
            let expected = case.residuals(&case.keep(&training).fit(), held.get(pair));
            assert!(if fraction > 0.0 {
                close(out, &expected, 1e-9)
            } else {
                out.iter().all(|e| e.is_nan())
            });
        }
    }
}

/// A number between -1 and 1 for every index.
fn entry(k: usize) -> f64 {
    ((k * 7919 + k * k % 104_729) % 1000) as f64 / 500.0 - 1.0
}

/// A weighted problem of two responses; the fourth column is seen by the last two rows, and by the others at a fraction.
fn nearly_lost(rows: usize, columns: usize, fraction: f64, penalised: bool) -> Case {
    let share = |i: usize, j: usize| if j == 3 && i + 2 < rows { fraction } else { 1.0 };
    Case {
        rows,
        columns,
        responses: 2,
        design: (0..rows * columns).map(|k| share(k / columns, k % columns) * entry(3 * k + 1)).collect(),
        targets: (0..2 * rows).map(|k| entry(5 * k + 2)).collect(),
        weights: (0..rows).map(|i| 1.2 + entry(7 * i)).collect(),
        penalty: if penalised {
            (0..2 * columns).map(|k| share(0, k % columns) * entry(k)).collect()
        } else {
            Vec::new()
        },
    }
}

/// Few rows and many, few columns and many: every way through nested models that is close to rank loss or not.
#[test]
fn leading_models_near_rank_loss_are_refits_too() {
    for (rows, columns) in [(40, 5), (40, 16), (1100, 6)] {
        for fraction in [1.0, 1e-2, 1e-4, 1e-7, 0.0] {
            for penalised in [false, true] {
                let case = nearly_lost(rows, columns, fraction, penalised);
                let held: Sets =
                    [vec![rows - 2, rows - 1], vec![3], vec![1, 3, rows - 2, rows - 1]].into_iter().collect();
                let validated: Sets = [vec![rows - 1], vec![3], vec![1, rows - 2]].into_iter().collect();
                let scheme =
                    Scheme { held: Held::Sets(&held), validated: &validated, order: Some(&[0, 1, 2]) };
                case.assert_refits(&case.curves(&[scheme], 1)[0], &held, &validated, 1e-8);
            }
        }
    }
}

/// Columns that depend on those before add no model; the others are still refits.
#[test]
fn leading_models_of_dependent_columns() {
    let mut case = nearly_lost(30, 9, 1.0, true);
    for matrix in [&mut case.design, &mut case.penalty] {
        for row in matrix.chunks_exact_mut(9) {
            row[2] = 0.0;
            row[5] = row[1] - 2.0 * row[4];
        }
    }
    let (alone, order): (Sets, Vec<usize>) = (singles(30), (0..30).collect());
    let scheme = Scheme { held: Held::Sets(&alone), validated: &alone, order: Some(&order) };
    case.assert_refits(&case.curves(&[scheme], 2)[0], &alone, &alone, 1e-9);
    case.with_problem(|problem| {
        let nested = Nested::new(problem, &pool(1)).unwrap();
        let fits = nested.fits(&[1, 3, 6, 9], &pool(2)).unwrap();
        for (fit, size) in fits.iter().zip([1, 3, 6, 9]) {
            let (model, plain) = (case.lead(size), case.lead(size).fit());
            let rows: Vec<usize> = (0..30).collect();
            let squares: f64 = model
                .residuals(&plain, &rows)
                .chunks_exact(2)
                .zip(&case.weights)
                .map(|(e, w)| w * (e[0] * e[0] + e[1] * e[1]))
                .sum();
            assert_eq!(fit.rank, plain.rank);
            assert!((fit.squares - squares).abs() < 1e-12 * squares);
            assert!((fit.parameters - plain.leverage.iter().sum::<f64>()).abs() < 1e-12);
            let mut solved = model.fit();
            solved.coefficients = nested.coefficients(size);
            assert!(close(&model.residuals(&solved, &rows), &model.residuals(&model.fit(), &rows), 1e-12));
        }
        assert_eq!(nested.fits(&[2, 1], &pool(1)).err(), Some(Error::Decreasing { index: 1 }));
    });
}

/// Long enough for several tasks: matrices are taken from the pair before and from the smaller scheme, whatever the order.
#[test]
fn schemes_together_are_each_alone_for_any_number_of_threads() {
    let case = nearly_lost(700, 12, 1e-3, false);
    let places: Vec<f64> = (0..700).map(|i| i as f64).collect();
    let near = |reach: f64| LazyNeighbourhoods::within(&places, 1, reach, &pool(1)).unwrap();
    let (small, large) = (near(6.0), near(30.0));
    let order: Vec<usize> = (0..350).chain((350..700).rev()).collect();
    let scheme = |lazy| Scheme { held: Held::Lazy(lazy), validated: &small.singletons, order: Some(&order) };
    let both = case.curves(&[scheme(&large), scheme(&small)], 1);
    let bits = |curve: &Curve| curve.squares.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    for threads in [2, 3] {
        let again = case.curves(&[scheme(&large), scheme(&small)], threads);
        assert!(again.iter().zip(&both).all(|(a, b)| bits(a) == bits(b) && a.defined == b.defined));
    }
    for (curve, lazy, reach) in [(&both[0], &large, 30), (&both[1], &small, 6)] {
        let alone = &case.curves(&[scheme(lazy)], 1)[0];
        assert!(close(&alone.squares, &curve.squares, 1e-11));
        let listed: Sets =
            (0..700usize).map(|i| (i.saturating_sub(reach)..700.min(i + reach + 1)).collect()).collect();
        let predicted = case.predict(&case.fit(), &listed, &singles(700), 2);
        let weighted = |i: usize| {
            case.weights[i] * predicted.residuals[2 * i..2 * i + 2].iter().map(|e| e * e).sum::<f64>()
        };
        let whole: f64 = (0..700).map(weighted).sum();
        assert!((curve.squares[11] - whole).abs() < 1e-9 * whole);
    }
}

#[test]
fn bad_schemes_are_errors() {
    let case = nearly_lost(10, 2, 1.0, false);
    let (alone, far): (Sets, Sets) = (singles(10), [vec![10]].into_iter().collect());
    let ten = Error::Index { index: 10, bound: 10 };
    let schemes = [
        (Scheme { held: Held::Sets(&far), validated: &far, order: Some(&[0]) }, ten),
        (Scheme { held: Held::Sets(&alone), validated: &alone, order: Some(&[10]) }, ten),
        (Scheme { held: Held::Sets(&alone), validated: &far, order: Some(&[0]) }, ten),
        (
            Scheme { held: Held::Sets(&alone), validated: &singles(9), order: Some(&[0]) },
            Error::Length { expected: 10, given: 9 },
        ),
    ];
    case.with_problem(|problem| {
        let nested = Nested::new(problem, &pool(1)).unwrap();
        for (scheme, error) in schemes {
            let found = nested.curves(problem, &[scheme], &singles(10), &[1, 2], &pool(1));
            assert_eq!(found.err(), Some(error));
        }
    });
}

/// Tall enough for many blocks, the last of fewer rows than columns, and many chunks: the stacked factorisation is still
/// orthonormal and still the design's, and threads change no bit.
#[test]
fn tall_designs_keep_an_orthonormal_basis() {
    let (rows, columns) = (8003, 11);
    let case = Case {
        rows,
        columns,
        responses: 1,
        design: (0..rows * columns).map(entry).collect(),
        targets: (0..rows).map(|i| entry(3 * i + 1)).collect(),
        weights: vec![1.0; rows],
        penalty: Vec::new(),
    };
    let fit = case.fit();
    for a in 0..columns {
        for b in 0..=a {
            let dot: f64 = (0..rows).map(|i| fit.basis_row(i)[a] * fit.basis_row(i)[b]).sum();
            assert!((dot - f64::from(u8::from(a == b))).abs() < 1e-13);
        }
    }
    assert!(close(&fit.plain_residuals(), &case.residuals(&fit, &(0..rows).collect::<Vec<_>>()), 1e-12));
    let windows: Sets = (0..rows).map(|i| (i..rows.min(i + 1 + i % 20)).collect()).collect();
    let bits = |x: Vec<f64>| x.into_iter().map(f64::to_bits).collect::<Vec<_>>();
    let [one, three] = [1, 3].map(|threads| {
        let fit = case.fit_on(threads);
        (bits(case.predict(&fit, &windows, &singles(rows), threads).residuals), bits(fit.basis))
    });
    assert!(one == three);
}

#[test]
fn bad_shapes_are_errors() {
    let mut problem = Problem {
        design: &[1.0; 6],
        responses: &[1.0; 3],
        root_weights: None,
        penalty: &[],
        rows: 3,
        columns: 2,
    };
    let fit = Factor::new(&problem, &pool(1)).unwrap();
    let sets: Sets = [vec![3]].into_iter().collect();
    let rows = singles(3);
    let found = fit
        .predict(
            &problem,
            &[Scheme { held: Held::Sets(&sets), validated: &sets, order: None }],
            &rows,
            &pool(1),
        )
        .err();
    assert_eq!(found, Some(Error::Index { index: 3, bound: 3 }));
    problem.design = &[1.0; 5];
    assert_eq!(Factor::new(&problem, &pool(1)).err(), Some(Error::Length { expected: 6, given: 5 }));
    let nothing = Problem { design: &[], responses: &[], ..problem };
    for (rows, columns) in [(0, 2), (3, 0), (0, 0)] {
        let empty = Problem { rows, columns, ..nothing };
        assert_eq!(Factor::new(&empty, &pool(1)).err(), Some(Error::Length { expected: 1, given: 0 }));
    }
}

#[test]
fn a_cancelled_pool_stops() {
    let stop = AtomicBool::new(true);
    let problem = Problem {
        design: &[1.0; 6],
        responses: &[1.0; 3],
        root_weights: None,
        penalty: &[],
        rows: 3,
        columns: 2,
    };
    assert_eq!(Factor::new(&problem, &Pool::new(2, &stop)).err(), Some(Error::Interrupted));
}
