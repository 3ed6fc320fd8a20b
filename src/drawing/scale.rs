//! Colour scales: perceptually uniform ones for magnitudes, a closed one for directions.

/// A way from values to colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Black over red and orange to pale yellow, much as the hot-metal scales that nuclear medicine reads perfusion in, but of even steps
    /// (matplotlib's, CC0).
    Inferno,
    /// Dark violet over green to yellow (matplotlib's, CC0).
    Viridis,
    /// Once around the hues, in the Oklab space (Ottosson 2020), brighter on one side: both ends are one colour, and opposite phases differ in
    /// lightness too, for those who do not tell hues apart.
    Cycle,
}

/// Colours of a scale, so that a picture in one scale is a picture of few colours.
pub const LEVELS: usize = 240;

/// Lightness in the middle and how far it swings, chroma, and the brightest hue in degrees of [`Scale::Cycle`]: just inside sRGB.
const CYCLE: (f64, f64, f64, f64) = (0.68, 0.15, 0.11, 110.0);

impl Scale {
    /// The scale of this name.
    pub fn named(name: &str) -> Option<Self> {
        [Self::Inferno, Self::Viridis, Self::Cycle].into_iter().find(|scale| scale.name() == name)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Inferno => "inferno",
            Self::Viridis => "viridis",
            Self::Cycle => "cycle",
        }
    }

    /// Red, green and blue (sRGB, 0-1) at a part of the scale, 0-1; the end's colour beyond. One of [`LEVELS`].
    pub fn colour(self, part: f64) -> [f32; 3] {
        self.of_level(self.level(part))
    }

    /// Which of the colours of [`Self::levels`] a part of the scale has.
    pub fn level(self, part: f64) -> usize {
        let part = if self == Self::Cycle { part.rem_euclid(1.0) } else { part.clamp(0.0, 1.0) };
        (part * self.last() as f64).round() as usize % LEVELS
    }

    /// All colours, from the first to the last.
    pub fn levels(self) -> [[f32; 3]; LEVELS] {
        std::array::from_fn(|level| self.of_level(level))
    }

    /// The level at the end of the scale, which on a circle is the first again.
    fn last(self) -> usize {
        if self == Self::Cycle { LEVELS } else { LEVELS - 1 }
    }

    fn of_level(self, level: usize) -> [f32; 3] {
        let part = level as f64 / self.last() as f64;
        let of_table = |gradient: colorous::Gradient| {
            let colour = gradient.eval_continuous(part);
            [colour.r, colour.g, colour.b].map(|byte| f32::from(byte) / 255.0)
        };
        match self {
            Self::Inferno => of_table(colorous::INFERNO),
            Self::Viridis => of_table(colorous::VIRIDIS),
            Self::Cycle => {
                let (middle, swing, chroma, brightest) = CYCLE;
                let hue = std::f64::consts::TAU * part;
                oklab(middle + swing * (hue - brightest.to_radians()).cos(), chroma * hue.cos(), chroma * hue.sin())
            }
        }
    }
}

/// sRGB of a colour in Oklab (<https://bottosson.github.io/posts/oklab/>), held to what a screen shows.
fn oklab(lightness: f64, a: f64, b: f64) -> [f32; 3] {
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ]
    .map(|linear| {
        let linear = linear.clamp(0.0, 1.0);
        (if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(colour: [f32; 3]) -> [u32; 3] {
        colour.map(f32::to_bits)
    }

    /// Relative luminance.
    fn light(colour: [f32; 3]) -> f64 {
        let linear = |part: f32| if part <= 0.04045 { f64::from(part) / 12.92 } else { ((f64::from(part) + 0.055) / 1.055).powf(2.4) };
        0.2126 * linear(colour[0]) + 0.7152 * linear(colour[1]) + 0.0722 * linear(colour[2])
    }

    #[test]
    fn more_is_brighter() {
        for scale in [Scale::Inferno, Scale::Viridis] {
            let lights: Vec<f64> = (0..=50).map(|step| light(scale.colour(f64::from(step) / 50.0))).collect();
            assert!(lights.windows(2).all(|pair| pair[1] > pair[0]), "{} {lights:?}", scale.name());
            assert_eq!(bits(scale.colour(-3.0)), bits(scale.colour(0.0)));
            assert_eq!(bits(scale.colour(1.7)), bits(scale.colour(1.0)));
            assert_eq!(Scale::named(scale.name()), Some(scale));
        }
    }

    #[test]
    fn a_cycle_closes_and_opposites_differ_in_lightness() {
        let scale = Scale::Cycle;
        assert_eq!(bits(scale.colour(0.0)), bits(scale.colour(1.0)));
        let step = |at: f64| {
            let (a, b) = (scale.colour(at), scale.colour(at + 0.01));
            a.iter().zip(b).map(|(a, b)| f64::from(a - b).abs()).fold(0.0, f64::max)
        };
        assert!((0..100).all(|at| step(f64::from(at) / 100.0) < 0.06), "no jump");
        assert!(light(scale.colour(110.0 / 360.0)) > 3.0 * light(scale.colour(290.0 / 360.0)));
    }

    #[test]
    fn few_colours_in_all() {
        let mut colours: Vec<[u32; 3]> = (0..5000).map(|step| Scale::Cycle.colour(f64::from(step) / 5000.0).map(f32::to_bits)).collect();
        colours.sort_unstable();
        colours.dedup();
        assert!(colours.len() <= LEVELS);
    }
}
