//! The scores of all leading models: what is asked of every pair of a sweep.

use super::dual::Dual;
use super::{Nested, add_squares};
use crate::fit::linalg::{self, dot};
use crate::fit::panels::PANEL;
use crate::fit::rank::leading_rank;
use crate::holdout::kernel::Bordered;
use crate::holdout::probes::{PROBES, sign};
use crate::holdout::residuals::MOST_CARRIED;
use crate::holdout::walk::{Ground, Question, Visit, Workspace};
use crate::pool::Pool;

/// Below this estimate of lambda_min(M), which may be several times too large, a pair needs twice the digits.
const PLAIN_MIN_EIGENVALUE: f64 = 1e-6;

/// Validated rows solved for together.
const CARRIED_ROWS: usize = 64;

/// A pair that was visited.
#[derive(Clone, Copy)]
pub(super) struct Visited {
    pub(super) scheme: usize,
    pub(super) step: usize,
    pub(super) pair: usize,
    /// An estimate of lambda_min(M) by plain arithmetic.
    pub(super) least: f64,
    /// To be refitted, as the rescue decides.
    pub(super) refit: bool,
}

impl Visited {
    fn new(at: Visit<'_>, least: f64) -> Self {
        Self {
            scheme: at.chain.schemes[at.k],
            step: at.step,
            pair: at.chain.pair(at.step),
            least,
            refit: false,
        }
    }
}

/// For which models the closed form solved a pair.
pub(super) enum Outcome {
    All,
    /// This many models are defined, and no more.
    Leading(usize),
    /// None: too close to rank loss for this arithmetic.
    Close,
}

/// What all portions read.
pub(super) struct AllModels<'a> {
    pub(super) ground: &'a Ground<'a>,
    pub(super) nested: &'a Nested,
    pub(super) cuts: &'a [usize],
}

/// Sums of squared residuals on a portion of the way.
pub(super) struct Scores {
    /// Chain x cuts.
    pub(super) squares: Vec<f64>,
    /// Number of defined models where these are not all.
    pub(super) cut: Vec<(Visited, usize)>,
    /// Those close to rank loss.
    pub(super) close: Vec<Visited>,
    curve: PairCurve,
    dual: Dual,
}

impl Scores {
    pub(super) fn new(schemes: usize, cuts: usize) -> Self {
        Self {
            squares: vec![0.0; schemes * cuts],
            cut: Vec::new(),
            close: Vec::new(),
            curve: PairCurve::new(cuts),
            dual: Dual::default(),
        }
    }

    fn note(&mut self, at: Visit<'_>, least: f64, outcome: &Outcome) {
        let cuts = self.curve.squares.len();
        if let Outcome::All | Outcome::Leading(_) = outcome {
            let sums = &mut self.squares[at.k * cuts..(at.k + 1) * cuts];
            sums.iter_mut().zip(&self.curve.squares).for_each(|(sum, x)| *sum += x);
        }
        match *outcome {
            Outcome::All => {}
            Outcome::Leading(defined) => self.cut.push((Visited::new(at, least), defined)),
            Outcome::Close => self.close.push(Visited::new(at, least)),
        }
    }
}

impl Question for AllModels<'_> {
    type Answer = Scores;

    fn dual(&self, work: &mut Workspace, at: Visit<'_>, primal: f64, answer: &mut Scores) -> bool {
        let factor = self.ground.factor;
        let (q, p) = (work.rows.len() as f64, factor.rank as f64);
        answer.curve.squares.fill(0.0);
        let outcome = if work.rows.is_empty() {
            Outcome::All
        } else if factor.total_rows < factor.rank + work.rows.len() {
            Outcome::Close
        } else if 4.0 * q * q * p <= primal + p * p
            && answer.dual.solve(
                self.nested,
                self.cuts,
                (&work.rows, work.validated),
                &mut answer.curve.squares,
            )
        {
            Outcome::All
        } else {
            return false;
        };
        answer.note(at, 0.0, &outcome);
        true
    }

    fn primal(&self, work: &mut Workspace, at: Visit<'_>, pool: &Pool<'_>, answer: &mut Scores) {
        let known = work.known_least(at.k);
        let riding = if known.is_none() && work.validated <= MOST_CARRIED { work.validated } else { 0 };
        let least = known.unwrap_or_else(|| work.factor_primal(self.ground.factor, at.k, riding));
        let validated = &work.rows[..work.validated];
        let outcome = answer.curve.primal(self, &mut work.system, least, (validated, riding > 0), pool);
        answer.note(at, least, &outcome);
    }
}

/// Squared prediction residuals of one pair.
pub(super) struct PairCurve {
    /// One a cut.
    pub(super) squares: Vec<f64>,
    forward: Vec<f64>,
}

impl PairCurve {
    pub(super) fn new(cuts: usize) -> Self {
        Self { squares: vec![0.0; cuts], forward: Vec::new() }
    }

    /// By the factor of the pair's matrix, which has this smallest eigenvalue; validated rows may ride along in its border.
    fn primal(
        &mut self,
        models: &AllModels<'_>,
        system: &mut Bordered,
        least: f64,
        (validated, riding): (&[usize], bool),
        pool: &Pool<'_>,
    ) -> Outcome {
        let factor = models.ground.factor;
        let (rank, responses) = (factor.rank, factor.responses);
        if least < PLAIN_MIN_EIGENVALUE {
            return Outcome::Close;
        }
        let Self { squares, forward } = self;
        squares.fill(0.0);
        for rows in validated.chunks(CARRIED_ROWS) {
            if riding {
                system.carry_border(responses + PROBES..responses + PROBES + rows.len());
            } else {
                system.carry(rows.iter().map(|&i| factor.basis_row(i)));
            }
            for c in 0..responses {
                system.forward_row(c, forward);
                system.add_transposed(&factor.projection[c * rank..(c + 1) * rank], forward);
                for (panel, rows) in system.carried().chunks_exact(rank.max(1)).zip(rows.chunks(PANEL)) {
                    let mut b = [0.0; PANEL];
                    b.iter_mut().zip(rows).for_each(|(b, &i)| *b = models.nested.right_row(i)[c]);
                    add_squares(b, panel, forward, models.cuts, squares);
                }
            }
        }
        if least > factor.certain_least() { Outcome::All } else { self.cut(models, &system.upper(), pool) }
    }

    /// Which models the training rows determine, by their triangle `L^T R`, given L^T.
    pub(super) fn cut(&mut self, models: &AllModels<'_>, upper: &[f64], pool: &Pool<'_>) -> Outcome {
        let factor = models.ground.factor;
        let (rank, cuts) = (factor.rank, models.cuts);
        let lost = factor.tolerance * (rank as f64).sqrt();
        let safe = (0..PROBES).all(|probe| {
            let mut x: Vec<f64> = (0..rank).map(|j| sign(probe, j)).collect();
            linalg::solve_upper(upper, rank, rank, &mut x, 1);
            linalg::solve_upper(&factor.triangle, rank, rank, &mut x, 1);
            // An estimate of the inverse's norm, give or take a factor of ten.
            10.0 * lost * dot(&x, &x).sqrt() < 1.0
        });
        if safe {
            return Outcome::All;
        }
        let triangle = linalg::product(upper, &factor.triangle, rank, rank, rank);
        match leading_rank(&triangle, rank, factor.tolerance, pool) {
            Ok(count) if count == rank => Outcome::All,
            Ok(count) => {
                let defined = cuts.partition_point(|&cut| cut <= count);
                self.squares[defined..].fill(f64::NAN);
                Outcome::Leading(defined)
            }
            Err(_) => Outcome::Close,
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use crate::holdout::nested::{Curve, Nested};
    use crate::holdout::scheme::{Held, Scheme};
    use crate::sets::Sets;
    use crate::testing::{Example, assert_close, bits, pool, sets, singletons, windows};

    type Pairs<'a> = (&'a Sets<'a>, &'a Sets<'a>, Option<&'a [usize]>);

    pub(crate) fn curves(example: &Example, pairs: &[Pairs<'_>], threads: usize) -> Vec<Curve> {
        let schemes: Vec<Scheme<'_>> = pairs
            .iter()
            .map(|&(held, validated, order)| Scheme { held: Held::Sets(held), validated, order })
            .collect();
        let (problem, sizes) = (example.problem(), (1..=example.columns).collect::<Vec<_>>());
        let nested = Nested::new(&problem, &pool(threads)).unwrap();
        nested.curves(&problem, &schemes, &singletons(example.rows), &sizes, &pool(threads)).unwrap()
    }

    /// Weighted squares of what plain refits of each model leave of the validated rows.
    pub(crate) fn refitted(example: &Example, held: &[usize], validated: &[usize]) -> Vec<f64> {
        let squares = |size: usize| {
            let residuals = example.lead(size).refit(held, validated);
            let rows = residuals.chunks(example.count).zip(validated);
            rows.map(|(e, &i)| e.iter().map(|e| (e * example.root_weights[i]).powi(2)).sum::<f64>()).sum()
        };
        (1..=example.columns).map(squares).collect()
    }

    fn sum_of_refits(example: &Example, held: &Sets, validated: &Sets) -> Vec<f64> {
        let mut sums = vec![0.0; example.columns];
        for pair in 0..held.len() {
            let curve = refitted(example, held.get(pair), validated.get(pair));
            sums.iter_mut().zip(curve).for_each(|(sum, x)| *sum += x);
        }
        sums
    }

    /// Two rows tell the last column from the one before; the others see a hundredth of that, which is rounding.
    #[test]
    fn what_is_certain_depends_on_how_near_rank_loss_the_design_is() {
        let mut example = Example::new(40, 3, 1);
        for (i, row) in example.design.chunks_exact_mut(3).enumerate() {
            let size = if i < 2 { 4e-12 } else { 4e-15 };
            row[2] = row[1] + if i % 2 == 0 { size } else { -size };
        }
        example.penalty.clear();
        example.root_weights.fill(1.0);
        let (held, validated) = (sets([&[0, 1], &[0, 1, 2, 3]]), sets([&[0], &[3]]));
        let squares = &curves(&example, &[(&held, &validated, None)], 1)[0].squares;
        assert!(squares[..2].iter().all(|square| square.is_finite()));
        assert!(squares[2].is_nan());
        let last = example.factor().closed_form_least();
        assert!(last > 1e-4, "{last}");
    }

    /// Few rows and many, alone and in chains, more validated than are solved for together.
    #[test]
    fn a_curve_is_what_each_model_says_alone() {
        let example = Example::new(90, 7, 2);
        let (alone, order) = (singletons(90), (0..90).collect::<Vec<_>>());
        let (small, large) = (windows(90, 1), windows(90, 8));
        let many: Vec<usize> = (3..75).collect();
        let fold = sets([&many]);
        let pairs: [Pairs<'_>; 4] = [
            (&small, &alone, Some(&order)),
            (&alone, &alone, None),
            (&large, &alone, Some(&order)),
            (&fold, &fold, None),
        ];
        for (curve, (held, validated, _)) in curves(&example, &pairs, 2).iter().zip(pairs) {
            assert_close(&curve.squares, &sum_of_refits(&example, held, validated), 1e-12);
            assert_eq!(curve.defined, vec![7; held.len()]);
        }
    }

    /// The third of four columns is seen by the last two rows alone: without them two models are left.
    #[test]
    fn a_model_without_rank_has_no_score_nor_have_larger_ones() {
        let mut example = Example::nearly_lost(40, 4, 0.0);
        example.design.chunks_exact_mut(4).for_each(|row| row.swap(2, 3));
        let held = sets([&[3, 4], &[38, 39, 1], &[39]]);
        let validated = sets([&[3], &[39, 38], &[39]]);
        let curve = &curves(&example, &[(&held, &validated, None)], 1)[0];
        assert_eq!(curve.defined, [4, 2, 4]);
        let expected = sum_of_refits(&example, &held, &validated);
        assert!(expected[2].is_nan() && expected[3].is_nan());
        assert_close(&curve.squares, &expected, 1e-12);
        // In the scheme's order, where it has one.
        let ordered = &curves(&example, &[(&held, &validated, Some(&[1, 0, 2]))], 1)[0];
        assert_eq!(ordered.defined, [2, 4, 4]);
    }

    /// A column that is nearly another's copy, and the difference of which the training rows see at a fraction: M is far
    /// from singular, and yet they have lost rank.
    #[test]
    fn of_an_ill_conditioned_design_the_triangle_decides() {
        let mut example = Example::nearly_lost(40, 4, 3e-4);
        example.design.chunks_exact_mut(4).for_each(|row| row[3] = row[1] + 1e-12 * row[3]);
        let held = sets([&[38, 39, 0, 1, 2, 3, 4], &[3, 4]]);
        let validated = sets([&[38, 0], &[3]]);
        let curve = &curves(&example, &[(&held, &validated, None)], 1)[0];
        assert_eq!(curve.defined, [3, 4]);
        assert!(curve.squares[3].is_nan());
        assert_close(&curve.squares[..3], &sum_of_refits(&example, &held, &validated)[..3], 1e-11);
    }

    #[test]
    fn no_bit_depends_on_threads() {
        let example = Example::nearly_lost(200, 9, 1e-4);
        let (alone, order) = (singletons(200), (0..200).rev().collect::<Vec<_>>());
        let held = [2, 30].map(|reach| windows(200, reach));
        let pairs = held.each_ref().map(|held| (held, &alone, Some(&order[..])));
        let [one, four] = [1, 4].map(|threads| curves(&example, &pairs, threads));
        for (one, four) in one.iter().zip(&four) {
            assert_eq!(bits(&one.squares), bits(&four.squares));
        }
    }
}
