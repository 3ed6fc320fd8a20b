//! Agreement of a method with the truth, after Bland & Altman 1986.

use crate::drawing::markdown::signed;

/// The half-width of the limits of agreement, and of a 95 % interval, in standard deviations.
pub const NORMAL_95: f64 = 1.96;

/// Errors of one quantity over studies. A study that failed has no error and is counted.
#[derive(Debug, Clone, PartialEq)]
pub struct Agreement {
    /// Studies, failed ones included.
    pub studies: usize,
    /// Studies without a result.
    pub failed: usize,
    /// Mean error of those that did not fail; NaN of none.
    pub bias: f64,
    /// Standard deviation of the errors about their mean (n − 1); NaN of fewer than two.
    pub sd: f64,
    /// The largest error by size, and the place of its study in the list.
    pub worst: Option<(f64, usize)>,
}

impl Agreement {
    /// Of a list of errors, `None` for a study that failed.
    pub fn of(errors: impl IntoIterator<Item = Option<f64>>) -> Self {
        let all: Vec<Option<f64>> = errors.into_iter().collect();
        let known: Vec<f64> = all.iter().copied().flatten().collect();
        let worst = all.iter().enumerate().filter_map(|(place, error)| error.map(|error| (error, place)));
        Self {
            studies: all.len(),
            failed: all.len() - known.len(),
            bias: mean(&known),
            sd: standard_deviation(&known),
            worst: worst.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs())),
        }
    }

    /// Bias ± 1.96 standard deviations.
    pub fn limits(&self) -> (f64, f64) {
        (self.bias - NORMAL_95 * self.sd, self.bias + NORMAL_95 * self.sd)
    }
}

impl Agreement {
    /// Bias ± standard deviation as it is read: the bias alone of one study, a dash of none.
    pub fn text(&self, decimals: usize) -> String {
        let bias = signed(self.bias, decimals);
        match (self.bias.is_finite(), self.sd.is_finite()) {
            (false, _) => "—".to_owned(),
            (true, false) => bias,
            (true, true) => format!("{bias} ± {:.decimals$}", self.sd),
        }
    }

    /// The limits of agreement as they are read.
    pub fn limits_text(&self) -> String {
        let (low, high) = self.limits();
        if self.sd.is_finite() { format!("{} to {}", signed(low, 1), signed(high, 1)) } else { "—".to_owned() }
    }
}

/// A value with decimals, or a dash where it is no number.
pub fn known(value: f64, decimals: usize) -> String {
    if value.is_finite() { format!("{value:.decimals$}") } else { "—".to_owned() }
}

/// The mean; NaN of nothing.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The standard deviation with n − 1; NaN of fewer than two.
pub fn standard_deviation(values: &[f64]) -> f64 {
    if values.len() < 2 {
        return f64::NAN;
    }
    let centre = mean(values);
    (values.iter().map(|value| (value - centre).powi(2)).sum::<f64>() / (values.len() - 1) as f64).sqrt()
}

/// Pearson's correlation of pairs; NaN where one side does not vary.
pub fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let (x, y): (Vec<f64>, Vec<f64>) = pairs.iter().copied().unzip();
    let (mean_x, mean_y) = (mean(&x), mean(&y));
    let product: f64 = pairs.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    product / ((pairs.len() as f64 - 1.0) * standard_deviation(&x) * standard_deviation(&y))
}

/// The share of ratios, errors over standard errors, that lie within the 95 % interval, in percent; NaN of none.
pub fn coverage_percent(ratios: &[f64]) -> f64 {
    100.0 * ratios.iter().filter(|ratio| ratio.abs() <= NORMAL_95).count() as f64 / ratios.len() as f64
}

/// How many gates two gates of a cycle (counted from 1) are apart, the short way round.
pub fn gates_apart(one: usize, other: usize, gates: usize) -> usize {
    let apart = one.abs_diff(other);
    apart.min(gates.saturating_sub(apart))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2, 4, 4, 4, 5, 5, 7, 9: mean 5, squares about it 9 + 1 + 1 + 1 + 0 + 0 + 4 + 16 = 32, so SD = √(32/7).
    #[test]
    fn bias_and_spread_of_those_that_did_not_fail() {
        let errors = [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0];
        let list = errors.iter().copied().map(Some).chain([None, None]);
        let agreement = Agreement::of(list);
        assert_eq!((agreement.studies, agreement.failed), (10, 2));
        assert!((agreement.bias - 5.0).abs() < 1e-12);
        assert!((agreement.sd - (32.0_f64 / 7.0).sqrt()).abs() < 1e-12);
        assert_eq!(agreement.worst, Some((9.0, 7)));
        let (low, high) = agreement.limits();
        assert!((high - low - 2.0 * 1.96 * (32.0_f64 / 7.0).sqrt()).abs() < 1e-12);
        assert!((f64::midpoint(low, high) - 5.0).abs() < 1e-12);
    }

    #[test]
    fn the_worst_is_by_size_and_keeps_its_sign() {
        assert_eq!(Agreement::of([Some(3.0), None, Some(-7.0)]).worst, Some((-7.0, 2)));
        let none = Agreement::of([None]);
        assert_eq!((none.text(1), Agreement::of([Some(2.0)]).text(1)), ("—".to_owned(), "+2.0".to_owned()));
        assert_eq!(Agreement::of([Some(2.0), Some(4.0)]).text(1), "+3.0 ± 1.4");
        assert!(none.bias.is_nan() && none.sd.is_nan() && none.worst.is_none() && none.failed == 1);
    }

    /// (1, 2), (2, 4), (3, 5): deviations −1, 0, 1 and −5/3, 1/3, 4/3; product 3, squares 2 and 42/9: r = 3 / √(2 · 14/3).
    #[test]
    fn correlation_by_hand() {
        let r = correlation(&[(1.0, 2.0), (2.0, 4.0), (3.0, 5.0)]);
        assert!((r - 3.0 / (28.0_f64 / 3.0).sqrt()).abs() < 1e-12, "{r}");
        assert!((correlation(&[(0.0, 1.0), (1.0, 0.0)]) + 1.0).abs() < 1e-12);
        assert!(correlation(&[(1.0, 1.0), (1.0, 2.0)]).is_nan());
    }

    #[test]
    fn gates_are_counted_the_short_way_round() {
        assert_eq!([(1, 8), (8, 1), (1, 5), (3, 4), (2, 2)].map(|(a, b)| gates_apart(a, b, 8)), [1, 1, 4, 1, 0]);
    }

    #[test]
    fn three_of_four_ratios_within_two() {
        assert!((coverage_percent(&[0.1, -1.9, 1.96, 2.5]) - 75.0).abs() < 1e-12);
    }
}
