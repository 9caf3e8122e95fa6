//! Many pictures on one sheet, each with its caption.

use super::{Image, RenderError};

/// One picture of a contact sheet.
#[derive(Debug, Clone)]
pub struct Panel {
    /// Line of text above the picture.
    pub caption: String,
    /// The picture.
    pub image: Image,
}

/// Lays pictures out in rows of `columns`, captions above, on a white sheet.
///
/// # Errors
/// When the sheet would be empty or too large.
pub fn contact_sheet(panels: &[Panel], columns: usize) -> Result<Image, RenderError> {
    const GAP: usize = 8;
    const CAPTION_HEIGHT: usize = 22;
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns);
    let cell_width = panels.iter().map(|p| p.image.width()).max().unwrap_or(0);
    let cell_height = panels.iter().map(|p| p.image.height()).max().unwrap_or(0) + CAPTION_HEIGHT;
    if cell_width == 0 {
        return Image::filled(0, 0, [255; 3]);
    }
    let sheet_width = columns * (cell_width + GAP) + GAP;
    let mut sheet = Image::filled(sheet_width, rows * (cell_height + GAP) + GAP, [255; 3])?;
    for (number, panel) in panels.iter().enumerate() {
        let left = GAP + number % columns * (cell_width + GAP);
        let top = GAP + number / columns * (cell_height + GAP);
        let fits_large = Image::text_width(&panel.caption, 2) <= cell_width;
        let letters = cell_width / if fits_large { 12 } else { 6 };
        let caption: String = panel.caption.chars().take(letters).collect();
        sheet.draw_text(left, top + 4, &caption, if fits_large { 2 } else { 1 }, [40, 44, 52]);
        sheet.paste(&panel.image, left, top + CAPTION_HEIGHT);
    }
    Ok(sheet)
}
