//! The dual: pairs solved in the space of their held-out rows, `(I - H_KK) z = e_K`, alone or each inside the next.
//!
//! Balls around one datum nest, and one factorisation serves them all: with the datum's rows first and then ring after ring,
//! a ball is a leading part of the largest, and so are its factor L and its forward solves `y = L^-1 e_K` and
//! `z = L^-1 1_T`, of which `e_(T) = z^T y`. Two or three rows are unrolled.

use crate::fit::factor::Factor;
use crate::fit::linalg::dot;
use crate::holdout::hat::Hat;
use crate::holdout::probes::{PROBES, by_probe, set_probes};
use crate::holdout::residuals::MOST_CARRIED;
use crate::holdout::walk::Workspace;

impl Workspace {
    /// `(I - H_KK) z = e_K` for two or three rows, in registers.
    pub(super) fn unrolled<const N: usize>(&self, factor: &Factor, out: &mut [f64]) -> f64 {
        let q: [&[f64]; N] = std::array::from_fn(|i| factor.basis_row(self.rows[i]));
        let mut l = [[0.0; N]; N];
        // Eigenvalues are at most one, so the least is at least their product.
        let mut least = 1.0;
        for i in 0..N {
            for j in 0..=i {
                let own = if i == j { 1.0 } else { 0.0 };
                let sum: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
                let value = own - dot(q[i], q[j]) - sum;
                if i == j {
                    least *= value.max(0.0);
                }
                l[i][j] = if i == j { value.max(0.0).sqrt() } else { value / l[j][j] };
            }
        }
        for c in 0..factor.responses {
            let mut z: [f64; N] = std::array::from_fn(|i| factor.residual_row(self.rows[i])[c]);
            for i in 0..N {
                z[i] = (z[i] - (0..i).map(|k| l[i][k] * z[k]).sum::<f64>()) / l[i][i];
            }
            for i in (0..N).rev() {
                z[i] = (z[i] - (i + 1..N).map(|k| l[k][i] * z[k]).sum::<f64>()) / l[i][i];
            }
            out.iter_mut().skip(c).step_by(factor.responses).zip(z).for_each(|(e, z)| *e = z);
        }
        least
    }

    /// Solves the pairs of the first `ends` rows, each inside the next, one block of residuals after another, and estimates
    /// their smallest eigenvalues; false if the largest cannot be factored. More validated rows than ride along are those
    /// of a single pair.
    pub(super) fn dual(
        &mut self,
        factor: &Factor,
        hat: Option<&Hat>,
        ends: &[usize],
        out: &mut [f64],
    ) -> bool {
        let (q, responses) = (ends.last().copied().unwrap_or(0), factor.responses);
        let carried = if self.validated <= MOST_CARRIED { self.validated } else { 0 };
        self.fill_dual(factor, hat, q, carried);
        if self.system.factor() <= 0.0 {
            return false;
        }
        self.least_eigenvalues(ends, responses);
        let block = self.validated * responses;
        for c in 0..responses {
            for k in 0..carried {
                let products = self.system.forward_products(c, responses + PROBES + k);
                leading_sums(products, ends, |pair, e| out[pair * block + k * responses + c] = e);
            }
            if carried < self.validated {
                let z = self.system.back_solve(c, 0);
                out[..block].iter_mut().skip(c).step_by(responses).zip(z).for_each(|(e, z)| *e = *z);
            }
        }
        true
    }

    /// `I - H_KK` of the first q rows, with residuals, and unit vectors of the first `carried` rows.
    pub(super) fn fill_dual(&mut self, factor: &Factor, hat: Option<&Hat>, q: usize, carried: usize) {
        let responses = factor.responses;
        self.factored = None;
        let rows = &self.rows[..q];
        let border = responses + PROBES + carried;
        match hat {
            None => self.system.start(q, border, factor.rank),
            Some(hat) => {
                self.places.clear();
                self.places.extend(rows.iter().map(|&row| hat.place[row]));
                self.system.start_complement(|i| hat.line(self.places[i]), &self.places, border);
            }
        }
        set_probes(&mut self.system, q, responses);
        for (i, &row) in rows.iter().enumerate() {
            if hat.is_none() {
                self.system.set_row(i, factor.basis_row(row));
            }
            for (c, &e) in factor.residual_row(row).iter().enumerate() {
                *self.system.entry(q + c, i) = e;
            }
        }
        for k in 0..carried {
            *self.system.entry(q + responses + PROBES + k, k) = 1.0;
        }
        self.system.clear_rows(q);
    }

    /// As [`least_eigenvalue`], of every leading part.
    fn least_eigenvalues(&mut self, ends: &[usize], responses: usize) {
        let Self { system, least, .. } = self;
        least.clear();
        least.resize(ends.len(), f64::INFINITY);
        let mut smallest = f64::INFINITY;
        let mut pivots = system.pivots();
        for ((least, &end), &start) in least.iter_mut().zip(ends).zip([0].iter().chain(ends)) {
            smallest = pivots.by_ref().take(end - start).fold(smallest, f64::min);
            *least = smallest;
        }
        drop(pivots);
        for probe in responses..responses + PROBES {
            leading_sums(system.forward_products(probe, probe), ends, |pair, sum| {
                least[pair] = least[pair].min(by_probe(sum, ends[pair]));
            });
        }
    }
}

/// Hands on the sums of the first `ends` terms, ends that do not decrease.
fn leading_sums(terms: impl Iterator<Item = f64>, ends: &[usize], mut hand: impl FnMut(usize, f64)) {
    let mut terms = terms;
    let (mut sum, mut start) = (0.0, 0);
    for (k, &end) in ends.iter().enumerate() {
        sum += terms.by_ref().take(end - start).sum::<f64>();
        start = end;
        hand(k, sum);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::holdout::probes::least_eigenvalue;
    use crate::testing::{Example, assert_close, pool, singletons};

    fn workspace(rows: &[usize], validated: usize) -> Workspace {
        let mut work = Workspace::new(0);
        (work.rows, work.validated) = (rows.to_vec(), validated);
        work
    }

    /// Weighted residuals, as the closed form gives them.
    fn refit(example: &Example, held: &[usize], rows: &[usize]) -> Vec<f64> {
        let plain = example.refit(held, rows);
        let weight = |k: usize| example.root_weights[rows[k / example.count]];
        plain.iter().enumerate().map(|(k, e)| e * weight(k)).collect()
    }

    #[test]
    fn two_or_three_rows_unrolled_are_what_any_number_is() {
        fn check<const N: usize>(example: &Example, rows: [usize; N]) {
            let (factor, mut work) = (example.factor(), workspace(&rows, N));
            let (mut unrolled, mut general) = (vec![0.0; 2 * N], vec![0.0; 2 * N]);
            let least = work.unrolled::<N>(&factor, &mut unrolled);
            assert!(work.dual(&factor, None, &[N], &mut general));
            assert_close(&unrolled, &general, 1e-14);
            assert_close(&unrolled, &refit(example, &rows, &rows), 1e-13);
            assert!(least > 0.0 && least <= work.least[0] * (1.0 + 1e-14));
        }
        let example = Example::new(25, 6, 2);
        check(&example, [20, 3]);
        check(&example, [7, 0, 19]);
    }

    /// With unit vectors that ride along, and by a back substitution; with the hat matrix and without.
    #[test]
    fn every_set_of_a_chain_is_solved_as_if_alone() {
        let example = Example::new(50, 6, 2);
        let factor = example.factor();
        let hat = Hat::new(&factor, &singletons(50), 0..50, &pool(1)).unwrap();
        let rows: Vec<usize> = (10..40).rev().collect();
        for hat in [None, Some(&hat)] {
            let mut work = workspace(&rows, 2);
            let ends = [2, 5, 5, 17, 30];
            let mut found = vec![0.0; 4 * ends.len()];
            assert!(work.dual(&factor, hat, &ends, &mut found));
            for (&end, found) in ends.iter().zip(found.chunks(4)) {
                assert_close(found, &refit(&example, &rows[..end], &rows[..2]), 1e-12);
            }
            let many = MOST_CARRIED + 3;
            let mut work = workspace(&rows, many);
            let mut found = vec![0.0; 2 * many];
            assert!(work.dual(&factor, hat, &[30], &mut found));
            assert_close(&found, &refit(&example, &rows, &rows[..many]), 1e-12);
        }
    }

    /// The larger a set, the less is left: estimates decrease along a chain, each as if the set were alone.
    #[test]
    fn every_set_of_a_chain_has_its_own_least_eigenvalue() {
        let factor = Example::nearly_lost(30, 4, 1e-3).factor();
        let rows = [5, 29, 7, 28, 3];
        let mut work = workspace(&rows, 1);
        let mut out = vec![0.0; 10];
        assert!(work.dual(&factor, None, &[1, 2, 3, 4, 5], &mut out));
        let together = work.least.clone();
        for (k, least) in together.iter().enumerate() {
            work.fill_dual(&factor, None, k + 1, 0);
            let alone = least_eigenvalue(&mut work.system, k + 1, factor.responses);
            assert!((least / alone - 1.0).abs() < 1e-6);
        }
        assert!(together[2] > 1e-2 && together[3] < 1e-4);
        let lost = Example::nearly_lost(30, 4, 0.0).factor();
        assert!(!work.dual(&lost, None, &[5], &mut out[..2]));
    }
}
