//! Colours in linear light, and the way to and from screen values.

/// A colour in linear light with the Rec. 709 primaries; 0 is black and 1 is full.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Color {
    /// Linear red.
    pub red: f32,
    /// Linear green.
    pub green: f32,
    /// Linear blue.
    pub blue: f32,
}

impl Color {
    /// The colour of screen values 0–255 (sRGB, IEC 61966-2-1).
    pub fn from_srgb(red: u8, green: u8, blue: u8) -> Self {
        let decode = |value: u8| {
            let v = f32::from(value) / 255.0;
            if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
        };
        Self { red: decode(red), green: decode(green), blue: decode(blue) }
    }

    /// The screen values 0–255 (sRGB) nearest to this colour.
    pub fn to_srgb(self) -> [u8; 3] {
        let encode = |value: f32| {
            let v = value.clamp(0.0, 1.0);
            let e = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
            (e * 255.0).round() as u8
        };
        [encode(self.red), encode(self.green), encode(self.blue)]
    }

    /// The colour of OKLab coordinates (B. Ottosson, "A perceptual color space for image processing", 2020), clipped to the screen.
    pub fn from_oklab(lightness: f32, green_red: f32, blue_yellow: f32) -> Self {
        let l = (lightness + 0.396_337_78 * green_red + 0.215_803_76 * blue_yellow).powi(3);
        let m = (lightness - 0.105_561_346 * green_red - 0.063_854_17 * blue_yellow).powi(3);
        let s = (lightness - 0.089_484_18 * green_red - 1.291_485_5 * blue_yellow).powi(3);
        Self {
            red: (4.076_741_7 * l - 3.307_711_6 * m + 0.230_969_94 * s).clamp(0.0, 1.0),
            green: (-1.268_438 * l + 2.609_757_4 * m - 0.341_319_38 * s).clamp(0.0, 1.0),
            blue: (-0.004_196_086_3 * l - 0.703_418_6 * m + 1.707_614_7 * s).clamp(0.0, 1.0),
        }
    }

    /// `(1 − share) · self + share · other`, in linear light.
    pub fn mix(self, other: Self, share: f32) -> Self {
        self.scaled(1.0 - share).plus(other.scaled(share))
    }

    pub(crate) fn scaled(self, factor: f32) -> Self {
        Self { red: self.red * factor, green: self.green * factor, blue: self.blue * factor }
    }

    pub(crate) fn plus(self, other: Self) -> Self {
        Self { red: self.red + other.red, green: self.green + other.green, blue: self.blue + other.blue }
    }
}
