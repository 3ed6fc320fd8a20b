//! Small dense symmetric systems.

/// Solves A x = b in place by Cholesky's factorisation; `a` holds the lower triangle by rows and is overwritten by its factor. `false` if A
/// is not positive definite.
pub(super) fn factor<const N: usize>(a: &mut [[f64; N]; N]) -> bool {
    for j in 0..N {
        let mut diagonal = a[j][j];
        for k in 0..j {
            diagonal -= a[j][k] * a[j][k];
        }
        if diagonal.is_nan() || diagonal <= 0.0 {
            return false;
        }
        let root = diagonal.sqrt();
        a[j][j] = root;
        for i in j + 1..N {
            let mut sum = a[i][j];
            for k in 0..j {
                sum -= a[i][k] * a[j][k];
            }
            a[i][j] = sum / root;
        }
    }
    true
}

/// Solves L Lᵀ x = b for a factor from [`factor`].
pub(super) fn solve<const N: usize>(factor: &[[f64; N]; N], mut b: [f64; N]) -> [f64; N] {
    for i in 0..N {
        for k in 0..i {
            b[i] -= factor[i][k] * b[k];
        }
        b[i] /= factor[i][i];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            b[i] -= factor[k][i] * b[k];
        }
        b[i] /= factor[i][i];
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
