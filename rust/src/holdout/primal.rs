//! The primal: pairs solved in the space of the coefficients, `e_(T) = e_T + Q_T M^-1 Q_K^T e_K`.

use std::ops::Range;

use crate::fit::factor::Factor;
use crate::fit::linalg::dot;
use crate::holdout::pairs::Workspace;
use crate::holdout::probes::{PROBES, least_eigenvalue, set_probes};
use crate::holdout::visit::MOST_CARRIED;

impl Workspace {
    pub(super) fn primal_factor(&mut self, factor: &Factor, carried: &Range<usize>) -> f64 {
        let border = factor.responses + PROBES + carried.len();
        self.system.start(factor.rank, border, self.rows.len());
        set_probes(&mut self.system, factor.rank, factor.responses);
        let rows = &self.rows;
        for (k, &row) in rows[carried.clone()].iter().enumerate() {
            for (j, &q) in factor.basis_row(row).iter().enumerate() {
                *self.system.entry(factor.rank + factor.responses + PROBES + k, j) = q;
            }
        }
        self.system.set_terms(|t| factor.basis_row(rows[t]), |t| factor.residual_row(rows[t]));
        least_eigenvalue(&mut self.system, factor.rank, factor.responses)
    }

    pub(super) fn primal(&mut self, factor: &Factor, out: &mut [f64]) -> f64 {
        let responses = factor.responses;
        let validated = 0..self.validated;
        let carry = validated.len() <= MOST_CARRIED;
        let least = self.primal_factor(factor, if carry { &validated } else { &(0..0) });
        if least < factor.closed_form_least() {
            return least;
        }
        for c in 0..responses {
            let rows = self.rows[validated.clone()].iter().enumerate();
            // The border came out as y = -L^-1 Q_K^T e_K, and carried rows as u = L^-1 q.
            if carry {
                for (k, &row) in rows {
                    let change: f64 = self.system.forward_products(c, responses + PROBES + k).sum();
                    out[k * responses + c] = factor.residual_row(row)[c] - change;
                }
            } else {
                let z = self.system.back_solve(c, 0);
                for (k, &row) in rows {
                    out[k * responses + c] = factor.residual_row(row)[c] - dot(factor.basis_row(row), z);
                }
            }
        }
        least
    }
}
