//! The score of a scheme: the root mean square of its prediction residuals.

use crate::fit::factor::Factor;
use crate::sets::Sets;

impl Factor {
    /// P of `P^2 = sum w ||e||^2 / sum w` over the validated data, of weights w, from the prediction residuals e of their
    /// rows, datum after datum. NaN without data, or if a residual is; squares overflow nowhere.
    pub fn score(&self, rows: &Sets<'_>, validated: &Sets<'_>, residuals: &[f64]) -> f64 {
        let weight = self.weight(rows, validated.items.iter().copied());
        let Some(roots) = &self.root_weights else {
            return root_mean(|| residuals.iter().map(|e| e.abs()), weight);
        };
        let sizes = || {
            let listed = validated.items.iter().flat_map(|&datum| rows.get(datum));
            let errors = listed.zip(residuals.chunks_exact(self.responses));
            errors.flat_map(|(&row, errors)| errors.iter().map(move |e| roots[row] * e.abs()))
        };
        root_mean(sizes, weight)
    }

    /// E of `E^2 = sum w ||e||^2 / sum w` over all data, which have these rows, with the residuals e of the fit.
    pub fn fit_rms(&self, rows: &Sets<'_>) -> f64 {
        let residuals = &self.residuals[..self.rows * self.responses];
        root_mean(|| residuals.iter().map(|e| e.abs()), self.weight(rows, 0..rows.len()))
    }

    /// The sum of the weights of data.
    fn weight(&self, rows: &Sets<'_>, data: impl ExactSizeIterator<Item = usize>) -> f64 {
        match &self.root_weights {
            None => data.len() as f64,
            Some(roots) => sum(data.map(|datum| roots[rows.get(datum)[0]].powi(2))),
        }
    }
}

/// `sqrt(sum e^2 / weight)` of sizes e, of any size.
fn root_mean<I: Iterator<Item = f64>>(sizes: impl Fn() -> I, weight: f64) -> f64 {
    let largest = sizes().fold(0.0, |most: f64, e| if most.is_nan() || e <= most { most } else { e });
    // Infinite residuals have no ratios.
    let unit = if largest > 0.0 && largest.is_finite() { largest } else { 1.0 };
    unit * (sum(sizes().map(|e| (e / unit).powi(2))) / weight).sqrt()
}

/// Terms that are added up before they join the sum, whose rounding grows with the number of its terms.
const TERMS: usize = 512;

fn sum(terms: impl Iterator<Item = f64>) -> f64 {
    let (mut whole, mut part) = (0.0, 0.0);
    for (k, term) in terms.enumerate() {
        if k % TERMS == 0 {
            whole += std::mem::take(&mut part);
        }
        part += term;
    }
    whole + part
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::factor::Problem;
    use crate::testing::pool;

    /// The score of residuals of data that have two rows, and two responses each.
    fn score(root_weights: Option<&[f64]>, validated: Vec<usize>, residuals: &[f64]) -> f64 {
        let (design, responses) = ([1.0, 2.0, 3.0, 5.0, 8.0, 13.0], [0.0; 12]);
        let problem = Problem {
            design: &design,
            responses: &responses,
            root_weights,
            penalty: &[],
            rows: 6,
            columns: 1,
        };
        let factor = Factor::new(&problem, &pool(1)).unwrap();
        let rows: Sets = [vec![0, 1], vec![2, 3], vec![4, 5]].into_iter().collect();
        factor.score(&rows, &[validated].into_iter().collect(), residuals)
    }

    #[test]
    fn it_averages_over_data_by_their_weights() {
        let e = [1.0, 2.0, 3.0, 4.0, -5.0, 6.0, 0.0, 1.0];
        assert!((score(None, vec![0, 2], &e) - (92.0_f64 / 2.0).sqrt()).abs() < 1e-14);
        let roots = [2.0, 2.0, 9.0, 9.0, 3.0, 3.0];
        let found = score(Some(&roots), vec![0, 2], &e);
        assert!((found - ((4.0 * 30.0 + 9.0 * 62.0) / 13.0_f64).sqrt()).abs() < 1e-14);
    }

    #[test]
    fn that_of_the_fit_is_of_all_its_residuals() {
        let (design, responses, roots) = ([1.0, 1.0, 1.0], [1.0, 2.0, 6.0], [1.0, 1.0, 2.0]);
        let mut problem = Problem {
            design: &design,
            responses: &responses,
            root_weights: None,
            penalty: &[],
            rows: 3,
            columns: 1,
        };
        let alone: Sets = (0..3).map(|i| vec![i]).collect();
        let fit_rms = |problem: &Problem<'_>| Factor::new(problem, &pool(1)).unwrap().fit_rms(&alone);
        assert!((fit_rms(&problem) - (14.0_f64 / 3.0).sqrt()).abs() < 1e-14);
        // The mean is 4.5.
        problem.root_weights = Some(&roots);
        assert!((fit_rms(&problem) - ((12.25 + 6.25 + 4.0 * 2.25) / 6.0_f64).sqrt()).abs() < 1e-14);
    }

    #[test]
    fn no_square_overflows_or_vanishes() {
        for unit in [1e-200, 1e200] {
            assert_eq!(score(None, vec![1], &[3.0 * unit, 0.0, 0.0, 4.0 * unit]), 5.0 * unit);
        }
        assert_eq!(score(None, vec![1], &[0.0; 4]), 0.0);
    }

    #[test]
    fn what_is_not_known_has_no_score() {
        assert!(score(None, vec![0, 1], &[1.0, f64::NAN, 9.0, 0.0, 1.0, 2.0, 3.0, 4.0]).is_nan());
        assert!(score(None, vec![], &[]).is_nan());
    }

    #[test]
    fn sums_of_many_terms_lose_few_digits() {
        let terms = 3_000_000;
        let error = |sum: f64| (sum - 0.1 * f64::from(terms)).abs();
        assert!(error((0..terms).map(|_| 0.1).sum()) > 1e-6);
        assert!(error(sum((0..terms).map(|_| 0.1))) < 1e-7);
    }
}
