//! Comma-separated rows (RFC 4180) for tables that people open in a spreadsheet.

/// Collects rows of fields.
#[derive(Default)]
pub(super) struct CsvText {
    text: String,
}

impl CsvText {
    /// A table with its header row.
    pub(super) fn with_header(names: &[&str]) -> Self {
        let mut table = Self::default();
        table.add_row(names.iter().copied());
        table
    }

    /// Adds a row; fields with commas, quotes or line breaks are quoted.
    pub(super) fn add_row<Field: AsRef<str>>(&mut self, fields: impl IntoIterator<Item = Field>) {
        for (index, field) in fields.into_iter().enumerate() {
            if index > 0 {
                self.text.push(',');
            }
            let field = field.as_ref();
            if field.contains([',', '"', '\n', '\r']) {
                self.text.push('"');
                self.text.push_str(&field.replace('"', "\"\""));
                self.text.push('"');
            } else {
                self.text.push_str(field);
            }
        }
        self.text.push('\n');
    }

    /// The finished table.
    pub(super) fn into_text(self) -> String {
        self.text
    }
}

#[cfg(test)]
mod tests {
    use super::CsvText;

    #[test]
    fn only_fields_that_need_it_are_quoted() {
        let mut table = CsvText::with_header(&["a", "b"]);
        table.add_row(["1.5", "plain words"]);
        table.add_row(["x,y", "say \"hi\"\nthere"]);
        assert_eq!(table.into_text(), "a,b\n1.5,plain words\n\"x,y\",\"say \"\"hi\"\"\nthere\"\n");
    }
}
