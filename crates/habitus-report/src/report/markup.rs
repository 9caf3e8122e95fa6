//! Text into HTML and JSON, safely: names from files may hold anything.

use serde::Serialize;

/// Text for HTML content or a quoted attribute.
pub(crate) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            other => out.push(other),
        }
    }
    out
}

/// JSON that may stand inside a script element: no `<` can end it.
pub(crate) fn script_json(value: &impl Serialize) -> Result<String, serde_json::Error> {
    let json = serde_json::to_string(value)?;
    Ok(json.replace('<', "\\u003c").replace('>', "\\u003e").replace('&', "\\u0026"))
}

/// A number with `decimals` digits after the point, a true minus sign, and "–" when it is not finite.
pub(crate) fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    match text.strip_prefix('-') {
        Some(rest) if is_zero => rest.to_owned(),
        Some(rest) => format!("−{rest}"),
        None => text,
    }
}

/// Seconds as a person says them.
pub(crate) fn duration(seconds: f64) -> String {
    if !seconds.is_finite() {
        "–".to_owned()
    } else if seconds < 1.0 {
        format!("{} ms", number(1e3 * seconds, usize::from(seconds < 0.01)))
    } else if seconds < 120.0 {
        format!("{} s", number(seconds, usize::from(seconds < 20.0)))
    } else {
        format!("{} min {} s", (seconds / 60.0).floor(), number((seconds % 60.0).floor(), 0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_in_a_name_can_leave_its_place() {
        let hostile = "</script><script>alert('x')</script>&\"";
        assert!(!escaped(hostile).contains(['<', '>', '"', '\'']));
        let json = script_json(&hostile).expect("json");
        assert!(!json.contains('<'));
        assert_eq!(serde_json::from_str::<String>(&json).expect("same text"), hostile);
    }

    #[test]
    fn numbers_read_well() {
        assert_eq!(number(-0.04, 1), "0.0");
        assert_eq!(number(-1.25, 1), "−1.2");
        assert_eq!(duration(0.0123), "12 ms");
        assert_eq!(duration(725.0), "12 min 5 s");
    }
}
