//! Heat-map colours: our own curves through OKLab, so equal steps of a value look like equal steps of colour.

use super::{Color, Image, RenderError};

/// Colour of a share 0–1: dark indigo, teal, pale yellow, with lightness rising linearly.
pub fn sequential_color(share: f64) -> Color {
    let t = share.clamp(0.0, 1.0) as f32;
    // Hue turns from 285° (indigo) to 105° (yellow); the chroma bulges in the middle so that no step is grey.
    let hue = (285.0 - 180.0 * t * (1.15 - 0.15 * t)).to_radians();
    let chroma = 0.085 + 0.16 * t * (1.0 - t);
    Color::from_oklab(0.30 + 0.63 * t, chroma * hue.cos(), chroma * hue.sin())
}

/// Colour of a signed share −1…1: vermilion below zero, a light neutral at zero, deep blue above.
pub fn diverging_color(signed_share: f64) -> Color {
    let t = signed_share.clamp(-1.0, 1.0) as f32;
    let strength = t.abs();
    let hue = if t < 0.0 { 38.0 + 10.0 * t } else { 195.0 + 68.0 * t };
    let hue = hue.to_radians();
    let chroma = 0.012 + 0.30 * strength - 0.14 * strength * strength;
    Color::from_oklab(
        0.93 - 0.38 * strength - 0.13 * strength * strength,
        chroma * hue.cos(),
        chroma * hue.sin(),
    )
}

/// A heat map of millimetres: zero is neutral, the two sides may have different reach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColorScale {
    /// Value in mm (negative) that gets the strongest warm colour.
    pub low_mm: f64,
    /// Value in mm (positive) that gets the strongest cool colour.
    pub high_mm: f64,
}

impl ColorScale {
    /// The scale for clearance between body and clothing: 20 mm outside to 60 mm inside.
    pub const CLEARANCE: Self = Self { low_mm: -20.0, high_mm: 60.0 };

    /// Colour of a value in mm; a value that is not finite is a mid grey.
    pub fn color(&self, value_mm: f64) -> Color {
        if !value_mm.is_finite() {
            return Color::from_srgb(128, 128, 128);
        }
        let reach = if value_mm < 0.0 { self.low_mm.abs() } else { self.high_mm.abs() };
        diverging_color(if reach > 0.0 { value_mm / reach } else { 0.0 })
    }

    /// The scale's colours at `count` even steps from low to high, as screen values.
    pub fn table(&self, count: usize) -> Vec<[u8; 3]> {
        (0..count)
            .map(|i| self.color(self.value_at(i as f64 / (count.max(2) - 1) as f64)).to_srgb())
            .collect()
    }

    fn value_at(&self, share: f64) -> f64 {
        self.low_mm + (self.high_mm - self.low_mm) * share
    }

    /// A horizontal legend bar with the low, zero and high value written below.
    ///
    /// # Errors
    /// When the size is not one of a picture.
    pub fn legend(&self, width: usize, height: usize) -> Result<Image, RenderError> {
        let mut image = Image::filled(width, height, [255, 255, 255])?;
        let margin = 8.min(width / 4);
        let bar_height = height.saturating_sub(16).max(1);
        let span = width - 2 * margin;
        for x in 0..span {
            let color = self.color(self.value_at(x as f64 / (span.max(2) - 1) as f64)).to_srgb();
            for y in 4.min(bar_height - 1)..bar_height {
                image.set_pixel(margin + x, y, color);
            }
        }
        let zero = margin
            + (span as f64 * -self.low_mm / (self.high_mm - self.low_mm)).clamp(0.0, span as f64) as usize;
        let label_y = bar_height + 4;
        let ink = [40, 44, 52];
        image.draw_text(margin, label_y, &format!("{:.0}", self.low_mm), 1, ink);
        image.draw_text(zero.saturating_sub(2), label_y, "0", 1, ink);
        let high = format!("{:.0} mm", self.high_mm);
        image.draw_text((width - margin).saturating_sub(Image::text_width(&high, 1)), label_y, &high, 1, ink);
        Ok(image)
    }
}
