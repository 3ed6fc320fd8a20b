//! What a drawing is made of, so that one layout is drawn as SVG and as pixels alike.

use super::{
    raster::Picture,
    svg::{Anchor, Sheet, hex},
};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster};

/// A red, green and blue, 0-1 each.
pub type Colour = [f32; 3];

/// One thing that is drawn. Coordinates and sizes are in units of the drawing, y downwards.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A picture in a square whose upper left corner and side are given.
    Picture {
        /// Upper left corner.
        at: (f64, f64),
        /// Side.
        side: f64,
        /// What is shown, square.
        picture: Picture,
    },
    /// Lines through points, in one stroke: where they cross nothing is drawn twice.
    Lines {
        /// Points of each line.
        lines: Vec<Vec<(f64, f64)>>,
        /// Colour.
        colour: Colour,
        /// Width.
        width: f64,
        /// 0 nothing to 1 all.
        opacity: f64,
    },
    /// A filled rectangle.
    Rectangle {
        /// Upper left corner.
        at: (f64, f64),
        /// Width and height.
        size: (f64, f64),
        /// Colour.
        colour: Colour,
    },
    /// A text.
    Text {
        /// Middle of the text in height; its begin, middle or end.
        at: (f64, f64),
        /// Height of its capitals and what hangs below, about 1.4 times the capitals.
        size: f64,
        /// Where it stands to its point.
        anchor: Anchor,
        /// Colour.
        colour: Colour,
        /// Colour of a rim around the letters, to be read on any ground.
        halo: Option<Colour>,
        /// Read from below.
        upright: bool,
        /// What it says: Latin letters.
        text: String,
    },
}

/// Width of a halo in parts of the text's size.
const HALO: f64 = 0.16;

/// Draws marks on a sheet of SVG.
///
/// # Errors
/// That of the PNG encoder.
pub fn on_sheet(sheet: &mut Sheet, marks: &[Mark]) -> Result<(), png::EncodingError> {
    for mark in marks {
        match mark {
            Mark::Picture { at, side, picture } => sheet.picture(*at, (*side, *side), &picture.png()?, false),
            Mark::Lines { lines, colour, width, opacity } => sheet.lines(lines, &hex(*colour), *width, *opacity),
            Mark::Rectangle { at, size, colour } => sheet.rectangle(*at, *size, &hex(*colour)),
            Mark::Text { at, size, anchor, colour, halo, upright, text } => {
                let halo = halo.map(|colour| (hex(colour), 2.0 * HALO * size));
                sheet.haloed_text(*at, *size, *anchor, &hex(*colour), halo, *upright, text);
            }
        }
    }
    Ok(())
}

/// Draws marks on a white picture, so many pixels a unit.
pub fn as_picture((width, height): (f64, f64), pixels: f64, marks: &[Mark]) -> Picture {
    let mut canvas = Picture::of_colour((width * pixels).round() as usize, (height * pixels).round() as usize, [1.0; 3]);
    let scaled = |(x, y): (f64, f64)| (x * pixels, y * pixels);
    for mark in marks {
        match mark {
            Mark::Picture { at, side, picture } => {
                let (left, top) = scaled(*at);
                scaled_onto(&mut canvas, picture, (left.round() as usize, top.round() as usize), (side * pixels).round() as usize);
            }
            Mark::Lines { lines, colour, width, opacity } => {
                let lines: Vec<Vec<(f64, f64)>> = lines.iter().map(|line| line.iter().copied().map(scaled).collect()).collect();
                stroke(&mut canvas, &lines, *colour, width * pixels, *opacity as f32);
            }
            Mark::Rectangle { at, size, colour } => {
                let ((left, top), (right, bottom)) = (scaled(*at), scaled((at.0 + size.0, at.1 + size.1)));
                for y in top.round() as usize..bottom.round() as usize {
                    for x in left.round() as usize..right.round() as usize {
                        canvas.set(x, y, *colour);
                    }
                }
            }
            Mark::Text { at, size, anchor, colour, halo, upright, text } => {
                let letters = letters(text, size * pixels, *upright);
                let (x, y) = scaled(*at);
                let back = |length: usize| match anchor {
                    Anchor::Start => 0.0,
                    Anchor::Middle => length as f64 / 2.0,
                    Anchor::End => length as f64,
                };
                let (left, top) = if *upright {
                    (x - letters.width as f64 / 2.0, y + back(letters.height) - letters.height as f64)
                } else {
                    (x - back(letters.width), y - letters.height as f64 / 2.0)
                };
                let corner = (left.round() as i64, top.round() as i64);
                if let Some(halo) = halo {
                    letters.grown((HALO * size * pixels).max(1.0)).onto(&mut canvas, corner, *halo);
                }
                letters.onto(&mut canvas, corner, *colour);
            }
        }
    }
    canvas
}

/// Copies a square picture at another size, each pixel from the nearest.
fn scaled_onto(canvas: &mut Picture, picture: &Picture, (left, top): (usize, usize), side: usize) {
    for y in 0..side {
        for x in 0..side {
            let (from_x, from_y) = (x * picture.width / side, y * picture.height / side);
            let at = 3 * (from_y * picture.width + from_x);
            canvas.set(left + x, top + y, [0, 1, 2].map(|part| f32::from(picture.rgb[at + part]) / 255.0));
        }
    }
}

/// Lines of a width in pixels, their edges smooth.
fn stroke(canvas: &mut Picture, lines: &[Vec<(f64, f64)>], colour: Colour, width: f64, opacity: f32) {
    let mut covered = vec![0.0_f32; canvas.width * canvas.height];
    let reach = width / 2.0 + 0.5;
    for pair in lines.iter().flat_map(|line| line.windows(2)) {
        let ((ax, ay), (bx, by)) = (pair[0], pair[1]);
        let (dx, dy) = (bx - ax, by - ay);
        let length2 = (dx * dx + dy * dy).max(f64::MIN_POSITIVE);
        let span = |low: f64, high: f64, most: usize| ((low - reach).max(0.0) as usize, ((high + reach).max(0.0) as usize + 1).min(most));
        let (left, right) = span(ax.min(bx), ax.max(bx), canvas.width);
        let (top, bottom) = span(ay.min(by), ay.max(by), canvas.height);
        for y in top..bottom {
            for x in left..right {
                let (px, py) = (x as f64 + 0.5 - ax, y as f64 + 0.5 - ay);
                let along = ((px * dx + py * dy) / length2).clamp(0.0, 1.0);
                let distance = (px - along * dx).hypot(py - along * dy);
                let part = (reach - distance).clamp(0.0, 1.0).min(width) as f32;
                let at = &mut covered[y * canvas.width + x];
                *at = at.max(part);
            }
        }
    }
    for (index, &part) in covered.iter().enumerate().filter(|(_, part)| **part > 0.0) {
        canvas.blend(index % canvas.width, index / canvas.width, colour, part * opacity);
    }
}

/// Letters as coverage, 0-1 a pixel.
struct Letters {
    width: usize,
    height: usize,
    covered: Vec<f32>,
}

/// A text in the nearest of the sizes that there are.
fn letters(text: &str, size: f64, upright: bool) -> Letters {
    let height = if size < 22.0 {
        RasterHeight::Size20
    } else if size < 28.0 {
        RasterHeight::Size24
    } else {
        RasterHeight::Size32
    };
    let glyph = |letter: char| get_raster(letter, FontWeight::Regular, height);
    let glyphs: Vec<_> = text.chars().filter_map(|letter| glyph(letter).or_else(|| glyph('?'))).collect();
    let (width, rows) = (glyphs.iter().map(noto_sans_mono_bitmap::RasterizedChar::width).sum(), height.val());
    let mut covered = vec![0.0; width * rows];
    let mut left = 0;
    for glyph in glyphs {
        for (y, row) in glyph.rows().enumerate() {
            for (x, &level) in row.iter().enumerate() {
                covered[y * width + left + x] = f32::from(level) / 255.0;
            }
        }
        left += glyph.width();
    }
    if !upright {
        return Letters { width, height: rows, covered };
    }
    // A quarter turn: what was right is up.
    let turned = (0..width).flat_map(|row| (0..rows).map(move |column| (column, width - 1 - row))).map(|(y, x)| covered[y * width + x]);
    Letters { width: rows, height: width, covered: turned.collect() }
}

impl Letters {
    /// With a rim of so many pixels; the same size, so that a rim over the edge is cut.
    fn grown(&self, rim: f64) -> Self {
        let reach = rim.ceil() as i64;
        let at = |x: i64, y: i64| {
            let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
            if inside { self.covered[y as usize * self.width + x as usize] } else { 0.0 }
        };
        let largest = |x: i64, y: i64| {
            let mut most = 0.0_f32;
            for dy in -reach..=reach {
                for dx in -reach..=reach {
                    let near = (rim + 0.5 - (dx as f64).hypot(dy as f64)).clamp(0.0, 1.0) as f32;
                    most = most.max(near * at(x + dx, y + dy));
                }
            }
            most
        };
        let covered = (0..self.height as i64).flat_map(|y| (0..self.width as i64).map(move |x| (x, y))).map(|(x, y)| largest(x, y));
        Self { width: self.width, height: self.height, covered: covered.collect() }
    }

    fn onto(&self, canvas: &mut Picture, (left, top): (i64, i64), colour: Colour) {
        for (index, &part) in self.covered.iter().enumerate().filter(|(_, part)| **part > 0.0) {
            let (x, y) = (left + (index % self.width) as i64, top + (index / self.width) as i64);
            if let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) {
                canvas.blend(x, y, colour, part);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dark(picture: &Picture) -> Vec<(usize, usize)> {
        (0..picture.width * picture.height)
            .filter(|pixel| picture.rgb[3 * pixel] < 128)
            .map(|pixel| (pixel % picture.width, pixel / picture.width))
            .collect()
    }

    #[test]
    fn a_line_has_its_width_and_a_crossing_is_drawn_once() {
        let lines = vec![vec![(2.0, 10.0), (18.0, 10.0)], vec![(10.0, 2.0), (10.0, 18.0)]];
        let mark = Mark::Lines { lines, colour: [0.0; 3], width: 2.0, opacity: 0.4 };
        let picture = as_picture((20.0, 20.0), 1.0, &[mark]);
        let at = |x: usize, y: usize| picture.rgb[3 * (y * 20 + x)];
        assert_eq!((at(5, 9), at(5, 10), at(5, 7), at(10, 10)), (153, 153, 255, 153));
    }

    #[test]
    fn a_text_stands_at_its_point_and_turns() {
        let text = |upright, anchor| Mark::Text {
            at: (50.0, 50.0),
            size: 24.0,
            anchor,
            colour: [0.0; 3],
            halo: None,
            upright,
            text: "LLL".to_owned(),
        };
        let bounds = |mark| {
            let pixels = dark(&as_picture((100.0, 100.0), 1.0, &[mark]));
            let (xs, ys): (Vec<usize>, Vec<usize>) = pixels.into_iter().unzip();
            (*xs.iter().min().unwrap(), *xs.iter().max().unwrap(), *ys.iter().min().unwrap(), *ys.iter().max().unwrap())
        };
        let (left, right, top, bottom) = bounds(text(false, Anchor::Start));
        assert!(left >= 50 && right < 95 && right - left > bottom - top && top > 38 && bottom < 62, "{left} {right} {top} {bottom}");
        let (left, right, top, bottom) = bounds(text(true, Anchor::Middle));
        assert!(bottom - top > right - left && left > 38 && right < 62 && top > 25 && bottom < 75, "{left} {right} {top} {bottom}");
        assert!(bounds(text(false, Anchor::End)).1 <= 50);
    }
}
