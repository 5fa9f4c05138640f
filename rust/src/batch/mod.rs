//! Many small problems in one call, each as if it were alone.
//!
//! Problems of one shape are solved side by side, see `lanes` and `pairs`, which serves those that are far from rank
//! loss, overflow and underflow. The others, and those that are too large for it, are solved one by one as
//! [`fit::factor`](crate::fit::factor) and [`holdout`](crate::holdout) do.

mod lanes;
mod pairs;
mod part;

use crate::batch::lanes::Shape;
use crate::batch::part::{Part, Workspace};
use crate::error::Error;
use crate::fit::factor::{Problem, expect_length};
use crate::holdout::scheme::{Scheme, check_indices};
use crate::pool::Pool;
use crate::sets::Sets;

/// Problems of one shape whose pairs hold out the same data, one after another.
pub struct Run<'a> {
    /// Their designs, row-major, one after another.
    pub designs: &'a [f64],
    /// Their responses, row-major, one after another.
    pub responses: &'a [f64],
    /// Roots of the weights of their rows, if they have any.
    pub root_weights: Option<&'a [f64]>,
    /// How many they are.
    pub count: usize,
    /// Rows of a problem.
    pub rows: usize,
    /// Columns of a design.
    pub columns: usize,
    /// What is held out.
    pub scheme: Scheme<'a>,
    /// The rows of each datum.
    pub data: &'a Sets<'a>,
}

/// What was found for every problem, run after run.
#[derive(Default)]
pub struct Found {
    /// x, columns x responses, column-major.
    pub coefficients: Vec<f64>,
    /// Prediction residuals of the validated rows in the responses' unit, row-major, pair after pair.
    pub residuals: Vec<f64>,
    /// Score of the scheme; NaN if a pair is undefined.
    pub scores: Vec<f64>,
    /// Root mean square residual of the fit.
    pub fit_rms: Vec<f64>,
    /// Rank of the design.
    pub ranks: Vec<usize>,
    /// Undefined pairs: the problem, and the pair.
    pub undefined: Vec<(usize, usize)>,
}

/// Fits and cross-validates all problems. An error of [`Error::NotFinite`] tells which is the first that has entries that
/// are not finite, or responses beyond 1e303.
pub fn cross_validate(runs: &[Run<'_>], pool: &Pool<'_>) -> Result<Found, Error> {
    runs.iter().try_for_each(Run::check)?;
    let mut found = Found::default();
    let total = |size: fn(&Run<'_>) -> usize| runs.iter().map(|run| run.count * size(run)).sum::<usize>();
    let count = total(|_| 1);
    found.coefficients = vec![0.0; total(|run| run.columns * run.width())];
    found.residuals = vec![0.0; total(|run| run.validated() * run.width())];
    found.scores = vec![0.0; count];
    found.fit_rms = vec![0.0; count];
    found.ranks = vec![0; count];
    let mut parts = part::cut(runs, &mut found);
    pool.run(parts.iter_mut(), Workspace::default, |work, part| part.solve(work, pool))?;
    let outcomes: Vec<_> = parts.into_iter().map(Part::outcome).collect();
    for undefined in outcomes {
        found.undefined.extend(undefined?);
    }
    Ok(found)
}

impl<'a> Run<'a> {
    /// Number of responses.
    fn width(&self) -> usize {
        self.responses.len() / (self.rows * self.count)
    }

    /// Number of validated rows.
    fn validated(&self) -> usize {
        self.data.total(&self.scheme.validated.items)
    }

    fn check(&self) -> Result<(), Error> {
        if self.rows.min(self.columns).min(self.count) == 0 {
            return Err(Error::Length { expected: 1, given: 0 });
        }
        expect_length(self.designs.len(), self.count * self.rows * self.columns)?;
        expect_length(self.responses.len(), self.count * self.rows * self.width())?;
        self.root_weights.map_or(Ok(()), |roots| expect_length(roots.len(), self.count * self.rows))?;
        check_indices(self.data, self.rows)?;
        self.scheme.check(self.data)
    }

    fn shape(&self) -> Shape {
        Shape { rows: self.rows, columns: self.columns, responses: self.width() }
    }

    fn problem(&self, k: usize) -> Problem<'a> {
        let (design, row) = (self.rows * self.columns, self.rows * self.width());
        Problem {
            design: &self.designs[k * design..(k + 1) * design],
            responses: &self.responses[k * row..(k + 1) * row],
            root_weights: self.root_weights.map(|roots| &roots[k * self.rows..(k + 1) * self.rows]),
            penalty: &[],
            rows: self.rows,
            columns: self.columns,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::factor::Factor;
    use crate::holdout::residuals::Status;
    use crate::holdout::scheme::Held;
    use crate::testing::{assert_close, bits, noise, pool, sets, singletons, windows};

    /// Problems of one shape, weighted, that hold out and validate what is listed.
    struct Stack {
        shape: Shape,
        count: usize,
        designs: Vec<f64>,
        responses: Vec<f64>,
        root_weights: Vec<f64>,
        held: Sets<'static>,
        validated: Sets<'static>,
        data: Sets<'static>,
    }

    impl Stack {
        fn new(count: usize, (rows, columns, responses): (usize, usize, usize), held: Sets<'static>) -> Self {
            Self {
                shape: Shape { rows, columns, responses },
                count,
                designs: noise(count * rows * columns, 1),
                responses: noise(count * rows * responses, 2),
                root_weights: noise(count * rows, 3).iter().map(|x| x + 1.5).collect(),
                validated: held.clone(),
                held,
                data: singletons(rows),
            }
        }

        fn run(&self) -> Run<'_> {
            Run {
                designs: &self.designs,
                responses: &self.responses,
                root_weights: Some(&self.root_weights),
                count: self.count,
                rows: self.shape.rows,
                columns: self.shape.columns,
                scheme: Scheme { held: Held::Sets(&self.held), validated: &self.validated, order: None },
                data: &self.data,
            }
        }

        fn design(&mut self, k: usize) -> &mut [f64] {
            let size = self.shape.rows * self.shape.columns;
            &mut self.designs[k * size..(k + 1) * size]
        }

        fn found(&self) -> Found {
            cross_validate(&[self.run()], &pool(1)).unwrap()
        }
    }

    /// Of problem k alone: coefficients, residuals, score, fitting error, rank and undefined pairs.
    type Alone = (Vec<f64>, Vec<f64>, f64, f64, usize, Vec<(usize, usize)>);

    fn alone(run: &Run<'_>, k: usize) -> Alone {
        let problem = run.problem(k);
        let fit = Factor::new(&problem, &pool(1)).unwrap();
        let found = fit.predict(&problem, &[run.scheme], run.data, &pool(1)).unwrap();
        let lost = (0..found.status.len()).filter(|&pair| found.status[pair] == Status::Undefined);
        let undefined: Vec<_> = lost.map(|pair| (k, pair)).collect();
        let score = if undefined.is_empty() {
            fit.score(run.data, run.scheme.validated, &found.residuals)
        } else {
            f64::NAN
        };
        (fit.coefficients.clone(), found.residuals, score, fit.fit_rms(run.data), fit.rank, undefined)
    }

    fn assert_as_alone(stack: &Stack, tolerance: f64) {
        let (run, found) = (stack.run(), stack.found());
        let mut undefined = Vec::new();
        for k in 0..run.count {
            let (coefficients, residuals, score, fit_rms, rank, lost) = alone(&run, k);
            let piece = |numbers: &[f64], size: usize| numbers[k * size..(k + 1) * size].to_vec();
            assert_close(&piece(&found.coefficients, coefficients.len()), &coefficients, tolerance);
            assert_close(&piece(&found.residuals, residuals.len()), &residuals, tolerance);
            assert_close(&[found.scores[k]], &[score], tolerance);
            assert_close(&[found.fit_rms[k]], &[fit_rms], tolerance);
            assert_eq!(found.ranks[k], rank);
            undefined.extend(lost);
        }
        assert_eq!(found.undefined, undefined);
    }

    /// More problems than lanes, and a few over; rows alone, pairs that are solved as dual and as primal, and an empty one.
    #[test]
    fn every_problem_is_solved_as_if_it_were_alone() {
        for count in [1, 2, 19, 67] {
            assert_as_alone(&Stack::new(count, (23, 4, 2), singletons(23)), 1e-13);
            assert_as_alone(&Stack::new(count, (23, 5, 1), windows(23, 4)), 1e-13);
            assert_as_alone(
                &Stack::new(count, (12, 3, 3), sets([&[4, 7], &[], &[0, 1, 2, 5, 11], &[9]])),
                1e-13,
            );
        }
    }

    #[test]
    fn data_of_several_rows_are_held_out_as_one_and_only_what_is_validated_is_predicted() {
        let mut stack = Stack::new(10, (20, 3, 2), windows(10, 1));
        stack.data = (0..10).map(|i| vec![i, 19 - i]).collect();
        stack.validated = singletons(10);
        for (k, root) in stack.root_weights.iter_mut().enumerate() {
            let row = k % 20;
            *root = 1.0 + 0.1 * row.min(19 - row) as f64;
        }
        assert_as_alone(&stack, 1e-13);
        assert_eq!(stack.found().residuals.len(), 10 * 20 * 2);
    }

    /// Lost rank, nearly lost rank, rows that alone see a column, and sizes whose squares overflow or vanish.
    #[test]
    fn hard_problems_do_not_disturb_their_neighbours() {
        let plain = Stack::new(12, (15, 3, 1), singletons(15));
        let mut stack = Stack::new(12, (15, 3, 1), singletons(15));
        stack.design(1).chunks_exact_mut(3).for_each(|row| row[2] = row[0] - row[1]);
        stack.design(2).chunks_exact_mut(3).for_each(|row| row[2] = row[0] + 1e-12 * row[1]);
        stack.design(4).chunks_exact_mut(3).skip(1).for_each(|row| row[0] = 0.0);
        stack.design(5).chunks_exact_mut(3).skip(1).for_each(|row| row[0] *= 1e-9);
        stack.design(7).iter_mut().for_each(|x| *x *= 1e180);
        stack.design(8).iter_mut().for_each(|x| *x *= 1e-180);
        stack.responses[9 * 15..10 * 15].fill(0.0);
        stack.responses[11 * 15..].iter_mut().for_each(|x| *x *= 1e-150);
        assert_as_alone(&stack, 1e-11);
        let (before, now) = (plain.found(), stack.found());
        assert_eq!(now.undefined, [(4, 0)]);
        for k in [0, 3, 6, 10] {
            let place = k * 15..(k + 1) * 15;
            assert_eq!(bits(&before.residuals[place.clone()]), bits(&now.residuals[place]));
        }
    }

    /// A shift by a multiple of a column that is exact in every digit, of one response in some of the lanes.
    #[test]
    fn multiples_of_a_column_leave_the_digits_of_residuals() {
        for held in [singletons(23), windows(23, 1), windows(23, 4)] {
            let mut stack = Stack::new(19, (23, 4, 2), held);
            stack.responses.iter_mut().for_each(|b| *b = (*b * 1024.0).round() / 1024.0);
            stack.designs.chunks_exact_mut(4).for_each(|row| row[2] = 2.0);
            let before = stack.found();
            for row in stack.responses.chunks_exact_mut(2 * 23).step_by(3).flat_map(|b| b.chunks_exact_mut(2))
            {
                row[1] += 2.0_f64.powi(40);
            }
            let now = stack.found();
            assert_close(&now.residuals, &before.residuals, 1e-12);
            assert_close(&now.scores, &before.scores, 1e-12);
            assert_close(&now.fit_rms, &before.fit_rms, 1e-12);
            let size = before.residuals.len() / 19;
            for k in 0..19 {
                let place = k * size..(k + 1) * size;
                let same = bits(&before.residuals[place.clone()]) == bits(&now.residuals[place]);
                assert_eq!(same, k % 3 > 0, "{k}");
                let shift = now.coefficients[8 * k + 6] - before.coefficients[8 * k + 6];
                let expected = if k % 3 > 0 { 0.0 } else { 2.0_f64.powi(39) };
                assert!((shift - expected).abs() <= 1e-15 * expected);
            }
        }
    }

    #[test]
    fn runs_of_several_shapes_come_one_after_another_for_any_number_of_threads() {
        let stacks = [
            Stack::new(150, (9, 2, 1), singletons(9)),
            Stack::new(1, (30, 7, 2), windows(30, 2)),
            Stack::new(90, (12, 12, 1), singletons(12)),
            Stack::new(3, (700, 30, 1), windows(700, 1)),
        ];
        let runs: Vec<_> = stacks.iter().map(Stack::run).collect();
        let all = cross_validate(&runs, &pool(1)).unwrap();
        let other = cross_validate(&runs, &pool(3)).unwrap();
        assert_eq!(bits(&all.residuals), bits(&other.residuals));
        assert_eq!((bits(&all.scores), &all.undefined), (bits(&other.scores), &other.undefined));
        let residuals: Vec<f64> = stacks.iter().flat_map(|stack| stack.found().residuals).collect();
        assert_eq!(bits(&all.residuals), bits(&residuals));
        // As many rows as columns: without one, none of these is determined.
        assert_eq!(all.undefined.len(), 90 * 12);
        assert_eq!(all.undefined[12], (152, 0));
    }

    #[test]
    fn what_is_no_number_is_an_error_of_its_problem() {
        for (number, is_response) in [(f64::NAN, false), (f64::INFINITY, false), (f64::NAN, true)] {
            let mut stack = Stack::new(90, (9, 2, 1), singletons(9));
            let matrix = if is_response { &mut stack.responses } else { &mut stack.designs };
            let size = matrix.len() / 90;
            matrix[size * 80] = number;
            matrix[size * 70 + 1] = number;
            assert_eq!(cross_validate(&[stack.run()], &pool(2)).err(), Some(Error::NotFinite { index: 70 }));
        }
    }

    #[test]
    fn arrays_that_do_not_fit_are_errors() {
        let stack = Stack::new(4, (9, 2, 1), singletons(9));
        let designs = &stack.designs[1..];
        let wrong = Run { designs, ..stack.run() };
        assert_eq!(cross_validate(&[wrong], &pool(1)).err(), Some(Error::Length { expected: 72, given: 71 }));
        let data = singletons(8);
        let wrong = Run { data: &data, ..stack.run() };
        assert_eq!(cross_validate(&[wrong], &pool(1)).err(), Some(Error::Index { index: 8, bound: 8 }));
        assert!(cross_validate(&[Run { count: 0, ..stack.run() }], &pool(1)).is_err());
    }
}
