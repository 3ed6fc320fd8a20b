//! Small dense symmetric systems.

/// Factors A into L Lᵀ (Cholesky): `a` holds the lower triangle by rows and is overwritten by L. `false` if A
/// is not positive definite.
pub(super) fn factor<const N: usize>(a: &mut [[f64; N]; N]) -> bool {
    for j in 0..N {
        for i in j..N {
            let known: f64 = a[i][..j].iter().zip(&a[j][..j]).map(|(x, y)| x * y).sum();
            let rest = a[i][j] - known;
            if i > j {
                a[i][j] = rest / a[j][j];
            } else if rest > 0.0 {
                a[j][j] = rest.sqrt();
            } else {
                return false;
            }
        }
    }
    true
}

/// Solves L Lᵀ x = b for a factor from [`factor`].
pub(super) fn solve<const N: usize>(factor: &[[f64; N]; N], mut b: [f64; N]) -> [f64; N] {
    for i in 0..N {
        let known: f64 = factor[i][..i].iter().zip(&b).map(|(x, y)| x * y).sum();
        b[i] = (b[i] - known) / factor[i][i];
    }
    for i in (0..N).rev() {
        let known: f64 = factor[i + 1..].iter().zip(&b[i + 1..]).map(|(row, y)| row[i] * y).sum();
        b[i] = (b[i] - known) / factor[i][i];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_system_is_solved_and_an_indefinite_one_refused() {
        let mut a = [[4.0, 0.0, 0.0], [2.0, 5.0, 0.0], [-1.0, 1.0, 3.0]];
        let x = [1.0, -2.0, 0.5];
        let b = [4.0 - 4.0 - 0.5, 2.0 - 10.0 + 0.5, -1.0 - 2.0 + 1.5];
        assert!(factor(&mut a));
        for (found, wanted) in solve(&a, b).into_iter().zip(x) {
            assert!((found - wanted).abs() < 1e-12);
        }
        assert!(!factor(&mut [[1.0, 0.0], [2.0, 1.0]]));
    }
}
