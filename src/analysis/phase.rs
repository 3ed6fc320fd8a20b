//! When each piece of the wall contracts: the phase of the first harmonic of its counts over the cycle (Chen et al., J Nucl Cardiol 2005;12:687).
//!
//! As a wall thickens, its counts rise by the partial-volume effect: the curve of counts over the gates is nearly the curve of thickness. Its
//! first Fourier harmonic `A cos(ωt − φ)` has its maximum at the phase φ: 0° is the R wave, 360° the next. A phase says when the wall is
//! thickest, not when it begins to thicken; packages differ by a constant there, which widths and differences do not see.

use super::places::Places;
use std::f64::consts::TAU;

/// Bins of the histogram, 6° each, as in Chen 2005.
pub const BINS: usize = 60;
/// Fewest gates that a phase is told from.
const FEWEST_GATES: usize = 4;
/// Vertices whose counts swing by less than this part of their mean are left out: noise has any phase.
const LEAST_SWING: f64 = 0.02;

/// Phases of the wall.
#[derive(Debug, Clone, PartialEq)]
pub struct Phase {
    /// In degrees, 0 to 360, `[vertices]`; `None` in the lid and where the counts hardly change.
    pub degrees: Vec<Option<f64>>,
    /// Amplitude of the first harmonic in percent of the mean counts, `[vertices]`; `None` in the lid.
    pub amplitude_percent: Vec<Option<f64>>,
    /// Circular mean in degrees.
    pub mean_degrees: f64,
    /// Standard deviation about the mean, of differences within ± 180°, in degrees.
    pub sd_degrees: f64,
    /// Width of the shortest arc that holds 95 % of the wall, in degrees.
    pub bandwidth_degrees: f64,
    /// −Σ p ln p / ln(bins) of the histogram, in percent: 0 all at once, 100 evenly spread.
    pub entropy_percent: f64,
    /// Part of the wall's area in each bin of 6°, the first from 0°, in percent. `[BINS]`.
    pub histogram_percent: Vec<f64>,
}

impl Phase {
    /// From the counts (or anything that rises as they do) at every gate, `[gates][vertices]`; `None` for too few gates or where nothing moves.
    pub fn of(counts: &[Vec<Option<f64>>], places: &Places) -> Option<Self> {
        let gates = counts.len();
        if gates < FEWEST_GATES {
            return None;
        }
        let harmonic = |vertex: usize| -> Option<(f64, f64)> {
            let (mut mean, mut cosine, mut sine) = (0.0, 0.0, 0.0);
            for (gate, of_gate) in counts.iter().enumerate() {
                let value = of_gate[vertex]?;
                let (s, c) = (TAU * (gate as f64 + 0.5) / gates as f64).sin_cos();
                mean += value;
                cosine += value * c;
                sine += value * s;
            }
            (mean > 0.0).then(|| (sine.atan2(cosine).to_degrees().rem_euclid(360.0), 2.0 * cosine.hypot(sine) / mean))
        };
        let harmonics: Vec<Option<(f64, f64)>> = (0..places.of_vertex.len()).map(harmonic).collect();
        let degrees: Vec<Option<f64>> =
            harmonics.iter().map(|harmonic| harmonic.and_then(|(degrees, swing)| (swing >= LEAST_SWING).then_some(degrees))).collect();
        let amplitude_percent = harmonics.iter().map(|harmonic| harmonic.map(|(_, swing)| 100.0 * swing)).collect();
        let weighted: Vec<(f64, f64)> =
            degrees.iter().zip(&places.of_vertex).filter_map(|(degrees, place)| Some(((*degrees)?, place.as_ref()?.area_mm2))).collect();
        let spread = Spread::of(&weighted)?;
        Some(Self {
            degrees,
            amplitude_percent,
            mean_degrees: spread.mean,
            sd_degrees: spread.sd,
            bandwidth_degrees: spread.bandwidth,
            entropy_percent: spread.entropy,
            histogram_percent: spread.histogram,
        })
    }
}

struct Spread {
    mean: f64,
    sd: f64,
    bandwidth: f64,
    entropy: f64,
    histogram: Vec<f64>,
}

impl Spread {
    /// Of angles in degrees with their weights; `None` without any.
    fn of(weighted: &[(f64, f64)]) -> Option<Self> {
        let whole: f64 = weighted.iter().map(|(_, weight)| weight).sum();
        if whole <= 0.0 {
            return None;
        }
        let mean = circular_mean(weighted.iter().copied())?;
        let apart = |degrees: f64| (degrees - mean + 180.0).rem_euclid(360.0) - 180.0;
        let variance = weighted.iter().map(|&(degrees, weight)| weight * apart(degrees).powi(2)).sum::<f64>() / whole;
        let mut histogram = vec![0.0; BINS];
        for &(degrees, weight) in weighted {
            histogram[((degrees / 360.0 * BINS as f64) as usize).min(BINS - 1)] += 100.0 * weight / whole;
        }
        let entropy = -histogram.iter().map(|percent| percent / 100.0).filter(|&part| part > 0.0).map(|part| part * part.ln()).sum::<f64>();
        Some(Self {
            mean,
            sd: variance.sqrt(),
            bandwidth: shortest_arc(weighted, 0.95 * whole),
            entropy: 100.0 * entropy / (BINS as f64).ln(),
            histogram,
        })
    }
}

/// The mean of angles in degrees with their weights, 0 to 360; `None` without any, or where they cancel.
pub fn circular_mean(weighted: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let (mut cosine, mut sine) = (0.0, 0.0);
    for (degrees, weight) in weighted {
        let (s, c) = degrees.to_radians().sin_cos();
        cosine += weight * c;
        sine += weight * s;
    }
    (cosine.hypot(sine) > 0.0).then(|| sine.atan2(cosine).to_degrees().rem_euclid(360.0))
}

/// Width in degrees of the shortest arc that holds so much of the weight.
fn shortest_arc(weighted: &[(f64, f64)], wanted: f64) -> f64 {
    let mut sorted = weighted.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = sorted.len();
    let at = |index: usize| sorted[index % count].0 + if index >= count { 360.0 } else { 0.0 };
    let (mut best, mut end, mut held) = (360.0_f64, 0, 0.0);
    for start in 0..count {
        while held < wanted && end < start + count {
            held += sorted[end % count].1;
            end += 1;
        }
        if held < wanted {
            break;
        }
        best = best.min(at(end - 1) - at(start));
        held -= sorted[start].1;
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_of_known_angles() {
        // Evenly over 350° to 10°.
        let angles: Vec<(f64, f64)> = (0..=200).map(|step| ((350.0 + 0.1 * f64::from(step)).rem_euclid(360.0), 1.0)).collect();
        let spread = Spread::of(&angles).unwrap();
        assert!(spread.mean < 1e-9 || spread.mean > 360.0 - 1e-9, "{}", spread.mean);
        // A uniform distribution of width w has the SD w/√12.
        assert!((spread.sd - 20.0 / 12.0_f64.sqrt()).abs() < 0.1, "{}", spread.sd);
        assert!((spread.bandwidth - 19.0).abs() < 0.11, "{}", spread.bandwidth);
        assert!((spread.histogram.iter().sum::<f64>() - 100.0).abs() < 1e-9);
        let one = Spread::of(&[(33.0, 2.0)]).unwrap();
        assert!(one.sd.abs() < 1e-9 && one.bandwidth.abs() < 1e-9 && one.entropy.abs() < 1e-9);
        let everywhere: Vec<(f64, f64)> = (0..360).map(|degrees| (f64::from(degrees), 1.0)).collect();
        assert!((Spread::of(&everywhere).map_or(100.0, |spread| spread.entropy) - 100.0).abs() < 1e-6);
        assert!(Spread::of(&[]).is_none());
    }

    #[test]
    fn a_wave_has_its_phase() {
        let place = super::super::Place { segment: 1, degrees: 0.0, radius: 0.5, area_mm2: 1.0 };
        let places = Places {
            of_vertex: vec![Some(place), Some(place), None],
            axes: [glam::DVec3::X, glam::DVec3::Y, glam::DVec3::Z],
            centre_mm: glam::DVec3::ZERO,
            rotation: super::super::RotationSource::Patient,
        };
        let wave = |degrees: f64, gate: usize| 100.0 + 20.0 * (TAU * (gate as f64 + 0.5) / 8.0 - degrees.to_radians()).cos();
        let counts: Vec<Vec<Option<f64>>> = (0..8).map(|gate| vec![Some(wave(130.0, gate)), Some(wave(150.0, gate)), None]).collect();
        let phase = Phase::of(&counts, &places).unwrap();
        assert!((phase.degrees[0].unwrap() - 130.0).abs() < 1e-9 && (phase.amplitude_percent[0].unwrap() - 20.0).abs() < 1e-9);
        assert!((phase.mean_degrees - 140.0).abs() < 1e-9 && (phase.bandwidth_degrees - 20.0).abs() < 1e-9);
        assert_eq!(phase.degrees[2], None);
        assert!(Phase::of(&counts[..3], &places).is_none());
    }
}
