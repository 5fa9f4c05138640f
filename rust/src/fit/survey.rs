//! What one look at all rows of a problem tells before it is factored.

use pulp::Arch;

use crate::error::Error;
use crate::fit::factor::Problem;
use crate::pool::Pool;

/// Rows of a block.
const ROWS: usize = 512;

/// The scales of the columns, and what every row was.
pub(super) struct Survey {
    /// Powers of two that bring every column's largest entry near one: overflow is then out of the way, and not a
    /// digit changes.
    pub scales: Vec<f64>,
    /// By row of `[A; Z]`, to notice that it has changed.
    pub fingerprints: Vec<u64>,
}

impl Survey {
    pub fn new(problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        let (columns, responses) = (problem.columns, problem.responses.len() / problem.rows);
        let mut fingerprints = vec![0; problem.total_rows()];
        // Sizes in bits: as whole numbers they compare alike, and one instruction compares several.
        let mut largest = vec![0; fingerprints.len().div_ceil(ROWS) * columns];
        pool.run(
            fingerprints.chunks_mut(ROWS).zip(largest.chunks_exact_mut(columns)).enumerate(),
            Arch::new,
            |arch, (block, (prints, largest))| {
                let rows = block * ROWS..block * ROWS + prints.len();
                arch.dispatch(|| {
                    for row in rows.clone() {
                        for (largest, a) in largest.iter_mut().zip(problem.row(row).0) {
                            *largest = (*largest).max(a.abs().to_bits() as i64);
                        }
                    }
                });
                // Vectors of whole numbers are multiplied slowly.
                prints
                    .iter_mut()
                    .zip(rows)
                    .for_each(|(print, row)| *print = problem.fingerprint(row, responses));
            },
        )?;
        let entry = |j: usize| largest.iter().skip(j).step_by(columns).fold(0, |a, &b| a.max(b));
        let scale = |j: usize| power_of_two(f64::from_bits(entry(j) as u64));
        Ok(Self { scales: (0..columns).map(scale).collect(), fingerprints })
    }
}

/// What brings a number near one, or leaves zero.
pub(super) fn power_of_two(largest: f64) -> f64 {
    if largest == 0.0 { 1.0 } else { (-largest.log2().ceil().clamp(-1000.0, 1000.0)).exp2() }
}

impl Problem<'_> {
    /// A number that changes with any digit of row `i`.
    pub(super) fn fingerprint(&self, i: usize, responses: usize) -> u64 {
        let (row, weight) = self.row(i);
        let mix = |sum: u64, x: &f64| (sum.rotate_left(7) ^ x.to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        // Four sums side by side: one multiplication need not wait for another.
        let (fours, rest) = row.as_chunks::<4>();
        let mut sums = [weight.to_bits(), 1, 2, 3];
        for four in fours {
            sums.iter_mut().zip(four).for_each(|(sum, x)| *sum = mix(*sum, x));
        }
        let sum = self.responses_of(i, responses).iter().chain(rest).fold(sums[0], mix);
        sums[1..].iter().fold(sum, |sum, other| mix(sum, &f64::from_bits(*other)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Example, pool};

    fn survey(design: &[f64], columns: usize, responses: &[f64], penalty: &[f64], threads: usize) -> Survey {
        let rows = design.len() / columns;
        let problem = Problem { design, responses, root_weights: None, penalty, rows, columns };
        Survey::new(&problem, &pool(threads)).unwrap()
    }

    #[test]
    fn scales_are_powers_of_two_of_the_largest_entries_above_a_penalty_or_in_it() {
        let design: Vec<f64> = (0..2000).flat_map(|i| [f64::from(i), -0.25, 0.0, 1e-300]).collect();
        let found = survey(&design, 4, &[], &[0.0, 0.0, 0.0, 3.0], 1);
        assert_eq!(found.scales, [1.0 / 2048.0, 4.0, 1.0, 0.25]);
        assert_eq!(found.fingerprints.len(), 2001);
    }

    #[test]
    fn fingerprints_change_with_any_digit_and_with_no_number_of_threads() {
        let design: Vec<f64> = (0..5400).map(|i| f64::from(i).sin()).collect();
        let responses: Vec<f64> = (0..600).map(|i| f64::from(i).cos()).collect();
        let found = survey(&design, 9, &responses, &[], 1).fingerprints;
        assert_eq!(found, survey(&design, 9, &responses, &[], 3).fingerprints);
        for entry in [0, 4, 8] {
            let mut changed = design.clone();
            changed[9 * 555 + entry] = changed[9 * 555 + entry].next_up();
            let now = survey(&changed, 9, &responses, &[], 1).fingerprints;
            assert_eq!((0..600).filter(|&i| now[i] != found[i]).collect::<Vec<_>>(), [555]);
        }
        let mut changed = responses.clone();
        changed[7] = -changed[7];
        assert_ne!(survey(&design, 9, &changed, &[], 1).fingerprints[7], found[7]);
    }

    #[test]
    fn any_digit_of_a_row_changes_its_print() {
        let example = Example::new(10, 6, 2);
        let print = |example: &Example| example.problem().fingerprint(3, 2);
        let before = print(&example);
        for k in 0..9 {
            let mut changed = example.clone();
            let x = match k {
                0..6 => &mut changed.design[18 + k],
                6..8 => &mut changed.responses[k],
                _ => &mut changed.root_weights[3],
            };
            *x = f64::from_bits(x.to_bits() ^ 1);
            assert_ne!(print(&changed), before, "number {k}");
        }
        let mut elsewhere = example.clone();
        elsewhere.design[0] += 1.0;
        assert_eq!(print(&elsewhere), before);
    }
}
