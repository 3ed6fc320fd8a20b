//! A sheet of SVG: text, lines and embedded pictures on white.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use std::fmt::Write as _;

/// Where a text stands to its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// The text begins at the point.
    Start,
    /// The text is centred on the point.
    Middle,
    /// The text ends at the point.
    End,
}

impl Anchor {
    fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Middle => "middle",
            Self::End => "end",
        }
    }
}

/// Colour of texts and axes.
pub const INK: &str = "#222";
/// Colour of grid lines and of what is said aside.
pub const FAINT: &str = "#666";

/// A drawing of a given size in pixels; the origin is the upper left corner.
#[derive(Debug, Clone)]
pub struct Sheet {
    width: f64,
    height: f64,
    body: String,
}

impl Sheet {
    /// An empty white sheet.
    pub fn new(width: f64, height: f64) -> Self {
        Self { width, height, body: String::new() }
    }

    /// Writing to a `String` does not fail.
    fn push(&mut self, element: std::fmt::Arguments<'_>) {
        let _ = writeln!(self.body, "{element}");
    }

    /// A text of a size in pixels.
    pub fn text(&mut self, (x, y): (f64, f64), size: f64, anchor: Anchor, colour: &str, text: &str) {
        let anchor = anchor.name();
        let text = escaped(text);
        self.push(format_args!(r#"<text x="{x:.1}" y="{y:.1}" font-size="{size}" text-anchor="{anchor}" fill="{colour}">{text}</text>"#));
    }

    /// A text read from below, centred on its point.
    pub fn upright_text(&mut self, (x, y): (f64, f64), size: f64, text: &str) {
        let text = escaped(text);
        self.push(format_args!(
            r#"<text transform="translate({x:.1} {y:.1}) rotate(-90)" font-size="{size}" text-anchor="middle" fill="{INK}">{text}</text>"#
        ));
    }

    /// A line through points; a gap where a coordinate is no number.
    pub fn line(&mut self, points: &[(f64, f64)], colour: &str, width: f64) {
        for part in points.split(|(x, y)| !x.is_finite() || !y.is_finite()).filter(|part| !part.is_empty()) {
            let list: Vec<String> = part.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
            let list = list.join(" ");
            self.push(format_args!(
                r#"<polyline points="{list}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-linejoin="round"/>"#
            ));
        }
    }

    /// Lines through points in one stroke: crossings are not darker where it is not opaque.
    pub fn lines(&mut self, lines: &[Vec<(f64, f64)>], colour: &str, width: f64, opacity: f64) {
        let place = |(index, (x, y)): (usize, &(f64, f64))| format!("{}{x:.1} {y:.1}", if index == 0 { 'M' } else { 'L' });
        let path: String = lines.iter().flat_map(|line| line.iter().enumerate().map(place)).collect();
        self.push(format_args!(
            r#"<path d="{path}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-opacity="{opacity}" stroke-linejoin="round"/>"#
        ));
    }

    /// A text whose middle in height is at the point, with a rim of a colour and width, and read from below if so wished.
    #[expect(clippy::too_many_arguments, reason = "a text has that many properties")]
    pub fn haloed_text(
        &mut self,
        (x, y): (f64, f64),
        size: f64,
        anchor: Anchor,
        colour: &str,
        halo: Option<(String, f64)>,
        upright: bool,
        text: &str,
    ) {
        let anchor = anchor.name();
        let halo = halo.map_or_else(String::new, |(colour, width)| {
            format!(r#" stroke="{colour}" stroke-width="{width:.2}" stroke-linejoin="round" paint-order="stroke""#)
        });
        let turn = if upright { " rotate(-90)" } else { "" };
        let text = escaped(text);
        // A third of its size below the middle: capitals and digits are then in the middle.
        self.push(format_args!(
            r#"<text transform="translate({x:.1} {y:.1}){turn}" y="{:.1}" font-size="{}" text-anchor="{anchor}" fill="{colour}"{halo}>{text}</text>"#,
            0.27 * size,
            0.76 * size
        ));
    }

    /// A filled rectangle.
    pub fn rectangle(&mut self, (x, y): (f64, f64), (width, height): (f64, f64), fill: &str) {
        self.push(format_args!(r#"<rect x="{x:.1}" y="{y:.1}" width="{width:.1}" height="{height:.1}" fill="{fill}"/>"#));
    }

    /// A disc.
    pub fn disc(&mut self, (x, y): (f64, f64), radius: f64, fill: &str) {
        self.push(format_args!(r#"<circle cx="{x:.1}" cy="{y:.1}" r="{radius}" fill="{fill}"/>"#));
    }

    /// A PNG picture scaled to a rectangle; `pixels` keeps its pixels square-edged.
    pub fn picture(&mut self, (x, y): (f64, f64), (width, height): (f64, f64), png: &[u8], pixels: bool) {
        let style = if pixels { r#" style="image-rendering:pixelated""# } else { "" };
        let data = STANDARD.encode(png);
        self.push(format_args!(
            r#"<image x="{x:.1}" y="{y:.1}" width="{width:.1}" height="{height:.1}"{style} href="data:image/png;base64,{data}"/>"#
        ));
    }

    /// The document, or a part of a page, with a name and a description for those who cannot see it; `id` keeps them apart within a page.
    pub fn described(self, id: &str, title: &str, description: &str) -> String {
        let Self { width, height, body } = self;
        let (title, description) = (escaped(title), escaped(description));
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
             aria-labelledby=\"{id}-title {id}-desc\" font-family=\"Helvetica, Arial, sans-serif\">\n\
             <title id=\"{id}-title\">{title}</title>\n<desc id=\"{id}-desc\">{description}</desc>\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n{body}</svg>\n"
        )
    }

    /// The document.
    pub fn finish(self) -> String {
        let Self { width, height, body } = self;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
             font-family=\"Helvetica, Arial, sans-serif\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n{body}</svg>\n"
        )
    }
}

/// A text as XML and HTML take it between tags and in attributes in double quotes.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A colour as SVG writes it.
pub fn hex(colour: [f32; 3]) -> String {
    let [r, g, b] = colour.map(|part| (part.clamp(0.0, 1.0) * 255.0).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_escaped_and_lines_break_where_there_is_no_number() {
        let mut sheet = Sheet::new(10.0, 10.0);
        sheet.text((1.0, 2.0), 12.0, Anchor::End, INK, "a < b & c");
        sheet.line(&[(0.0, 0.0), (1.0, 1.0), (f64::NAN, 2.0), (3.0, 3.0)], INK, 1.0);
        let text = sheet.finish();
        assert!(text.contains("a &lt; b &amp; c"), "{text}");
        assert_eq!(text.matches("<polyline").count(), 2, "{text}");
    }
}
