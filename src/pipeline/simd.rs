//! Loops compiled for several instruction sets, the best of which is chosen when the program runs: one binary for all machines.
//!
//! `vectorised!` declares a function whose body is compiled once for each [`Level`]. The compiler vectorises it; nothing is written by
//! hand. Rust neither reorders floating-point sums nor contracts products and sums, so a body gives the same bits at every level; one that
//! wants its sums vectorised has to add in lanes of its own.
//!
//! The one place with `unsafe` code: calling a function compiled for instructions that [`level`] has found on this processor.

use std::sync::atomic::{AtomicU8, Ordering};

/// What a processor can do, in ascending order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Level {
    /// What every processor of the architecture can: SSE2 on x86-64 and NEON on 64-bit ARM, four numbers at once.
    Baseline = 1,
    /// Eight numbers at once.
    Avx2 = 2,
    /// Sixteen numbers at once.
    Avx512 = 3,
}

impl Level {
    /// All levels, the least first.
    pub const ALL: [Self; 3] = [Self::Baseline, Self::Avx2, Self::Avx512];

    /// The name of the instruction set.
    pub fn name(self) -> &'static str {
        match self {
            Self::Baseline if cfg!(target_arch = "aarch64") => "neon",
            Self::Baseline if cfg!(target_arch = "x86_64") => "sse2",
            Self::Baseline => "baseline",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The best that this processor has.
    pub fn detected() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected;
            if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl") && is_x86_feature_detected!("avx512dq") {
                return Self::Avx512;
            }
            if is_x86_feature_detected!("avx2") {
                return Self::Avx2;
            }
        }
        Self::Baseline
    }
}

/// The level in use; 0 before the first question.
static CHOSEN: AtomicU8 = AtomicU8::new(0);

/// The level that vectorised functions run at.
pub fn level() -> Level {
    match CHOSEN.load(Ordering::Relaxed) {
        1 => Level::Baseline,
        2 => Level::Avx2,
        3 => Level::Avx512,
        _ => use_at_most(Level::Avx512),
    }
}

/// Chooses the best level that the processor has and that is not above this one: to measure what each brings, and to show that all give
/// the same bits. Returns what was chosen. Results do not depend on it.
pub fn use_at_most(most: Level) -> Level {
    let chosen = Level::detected().min(most);
    CHOSEN.store(chosen as u8, Ordering::Relaxed);
    chosen
}

/// Declares a function that is compiled for every [`Level`] and dispatched when it is called. What its body calls must be
/// `#[inline(always)]` or as small as iterators are, else it is compiled for the baseline only. Calls cost some nanoseconds: whole loops
/// belong inside.
macro_rules! vectorised {
    ($(#[$attribute:meta])* $visibility:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $result:ty)? $body:block) => {
        $(#[$attribute])*
        $visibility fn $name($($argument: $type),*) $(-> $result)? {
            #[allow(clippy::inline_always)]
            #[inline(always)]
            fn body($($argument: $type),*) $(-> $result)? $body
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn avx2($($argument: $type),*) $(-> $result)? {
                    body($($argument),*)
                }
                #[target_feature(enable = "avx512f,avx512vl,avx512dq")]
                fn avx512($($argument: $type),*) $(-> $result)? {
                    body($($argument),*)
                }
                // SAFETY: `level` is never above what was detected on this processor.
                #[allow(unsafe_code)]
                match $crate::pipeline::simd::level() {
                    $crate::pipeline::simd::Level::Avx512 => return unsafe { avx512($($argument),*) },
                    $crate::pipeline::simd::Level::Avx2 => return unsafe { avx2($($argument),*) },
                    $crate::pipeline::simd::Level::Baseline => {}
                }
            }
            body($($argument),*)
        }
    };
}

pub(crate) use vectorised;

/// e to the power x, to 1e-15 of it, without a call: for loops that are to be vectorised. Below −700 it is e⁻⁷⁰⁰, above 700 e⁷⁰⁰.
///
/// x = n ln 2 + r with |r| ≤ ln 2 / 2; e^r by its Taylor series to r¹³, whose first term left out is 4e-18; 2^n by the exponent's bits.
#[allow(clippy::inline_always)]
#[inline(always)]
pub(crate) fn exp(x: f64) -> f64 {
    /// ln 2 in two parts, the first with enough zeros at its end that n times it is exact.
    const LN_2: [f64; 2] = [0.693_147_180_369_123_8, 1.908_214_929_270_587_7e-10];
    /// 1.5 · 2⁵²: a number added to it is rounded to a whole one, which then stands in its last bits.
    const ROUNDS: f64 = 6_755_399_441_055_744.0;
    const TERMS: [f64; 14] = [
        1.0,
        1.0,
        1.0 / 2.0,
        1.0 / 6.0,
        1.0 / 24.0,
        1.0 / 120.0,
        1.0 / 720.0,
        1.0 / 5040.0,
        1.0 / 40_320.0,
        1.0 / 362_880.0,
        1.0 / 3_628_800.0,
        1.0 / 39_916_800.0,
        1.0 / 479_001_600.0,
        1.0 / 6_227_020_800.0,
    ];
    let x = x.clamp(-700.0, 700.0);
    let rounded = x * std::f64::consts::LOG2_E + ROUNDS;
    let n = rounded - ROUNDS;
    let r = (x - n * LN_2[0]) - n * LN_2[1];
    let mut sum = TERMS[13];
    for term in TERMS[..13].iter().rev() {
        sum = sum * r + term;
    }
    // The whole number in the last bits, moved to where the exponent stands.
    let exponent = rounded.to_bits().wrapping_sub(ROUNDS.to_bits()).wrapping_shl(52);
    f64::from_bits(sum.to_bits().wrapping_add(exponent))
}

/// Lanes that a sum is split into, whatever the instruction set: two of the widest registers.
pub(crate) const LANES: usize = 32;

vectorised! {
    /// The sum of a · b, each product in f64: lanes of their own, added up in order, so that it is the same at every level.
    pub(crate) fn dot(a: &[f32], b: &[f32]) -> f64 {
        let mut lanes = [0.0_f64; LANES];
        let (whole_a, rest_a) = a.as_chunks::<LANES>();
        let (whole_b, rest_b) = b.as_chunks::<LANES>();
        for (a, b) in whole_a.iter().zip(whole_b) {
            for lane in 0..LANES {
                lanes[lane] += f64::from(a[lane]) * f64::from(b[lane]);
            }
        }
        for (lane, (a, b)) in lanes.iter_mut().zip(rest_a.iter().zip(rest_b)) {
            *lane += f64::from(*a) * f64::from(*b);
        }
        lanes.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_gives_the_same_bits() {
        let numbers = |seed: f32| (0..1000).map(|i| (seed * i as f32).sin()).collect::<Vec<_>>();
        let (a, b) = (numbers(0.37), numbers(1.91));
        let sums: Vec<(Level, f64)> = Level::ALL.iter().map(|&most| (use_at_most(most), dot(&a, &b))).collect();
        use_at_most(Level::Avx512);
        assert!(sums.iter().all(|(_, sum)| sum.to_bits() == sums[0].1.to_bits()), "{sums:?}");
        let plain: f64 = a.iter().zip(&b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum();
        assert!((sums[0].1 - plain).abs() < 1e-9 * plain.abs().max(1.0), "{sums:?} {plain}");
    }

    #[test]
    fn the_exponential_is_the_libraries() {
        for i in -70_000..=70_000 {
            let x = f64::from(i) * 0.01 + 1e-5;
            let x = x.clamp(-700.0, 700.0);
            assert!((exp(x) / x.exp() - 1.0).abs() < 1e-15, "{x}: {} {}", exp(x), x.exp());
        }
        assert_eq!((exp(0.0).to_bits(), exp(-1e9).to_bits()), (1.0_f64.to_bits(), exp(-700.0).to_bits()));
        assert!(exp(f64::NAN).is_nan());
    }

    #[test]
    fn no_level_is_chosen_that_the_processor_has_not() {
        assert!(Level::ALL.iter().all(|&most| use_at_most(most) <= most.min(Level::detected())));
        use_at_most(Level::Avx512);
        assert_eq!(level(), Level::detected());
    }
}
