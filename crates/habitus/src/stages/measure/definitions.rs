//! Definitions of measurements: data, not code. The embedded set is `definitions.toml`.

use serde::Deserialize;
use thiserror::Error;

const VERSION: i64 = 1;
const SIDES: [&str; 2] = ["left", "right"];

/// Why a set of definitions cannot be used.
#[derive(Debug, Error)]
pub enum DefinitionsError {
    /// The text is not a set of definitions.
    #[error("measurement definitions: {0}")]
    Malformed(#[from] toml::de::Error),
    /// One measurement lacks its name or its words.
    #[error("a measurement has no text under '{key}'")]
    NoText {
        /// `name` or `definition`.
        key: &'static str,
    },
    /// One measurement's method cannot be understood.
    #[error("measurement '{name}': {source}")]
    Unusable {
        /// The measurement.
        name: String,
        /// What is wrong.
        source: toml::de::Error,
    },
    /// The set was written for a newer program.
    #[error(
        "measurement definitions have version {found}, this program reads up to {VERSION}; update habitus"
    )]
    Newer {
        /// Its version.
        found: i64,
    },
    /// Two measurements share a name.
    #[error("measurement '{name}' is defined twice; give each its own name")]
    Duplicate {
        /// The name.
        name: String,
    },
}

/// A place on the body.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum PointReference {
    /// `floor`, `top`, `vertex:NAME`, `landmark:NAME` or `joint:BONE`.
    Named(String),
    /// A point on the straight line through two others.
    Between {
        /// The two points.
        between: Box<[PointReference; 2]>,
        /// 0 at the first, 1 at the second; may lie outside.
        at: f64,
    },
}

/// Where a tape goes around the body.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tape {
    /// Only the parts that mainly follow these bones are touched.
    pub bones: Vec<String>,
    /// The cut is perpendicular to the line between these points; horizontal when absent.
    pub along: Option<Box<[PointReference; 2]>>,
    /// Of several pieces of the cut, only the one nearest to this point; all when absent.
    pub around: Option<PointReference>,
}

/// Which girth a search keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Extreme {
    /// The smallest.
    Smallest,
    /// The largest.
    Largest,
}

/// Horizontal direction of a breadth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BreadthDirection {
    /// Along the line between the two points of `across`.
    Sideways,
    /// Horizontally across that line.
    FrontToBack,
}

/// How a measurement is taken.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Method {
    /// Vertical distance between two points.
    Height {
        /// Lower end.
        from: PointReference,
        /// Upper end.
        to: PointReference,
    },
    /// Length of the straight lines through points.
    Length {
        /// The points in order.
        through: Vec<PointReference>,
    },
    /// Extent of a horizontal cut in one direction.
    Breadth {
        /// The cut goes through this point.
        at: PointReference,
        /// Two points that say what sideways means.
        across: Box<[PointReference; 2]>,
        /// Which way to measure.
        direction: BreadthDirection,
        /// Which parts count.
        tape: Tape,
    },
    /// Taut tape through a point.
    Girth {
        /// The cut goes through this point.
        at: PointReference,
        /// Where the tape goes.
        tape: Tape,
    },
    /// The smallest or largest girth between two points.
    ExtremeGirth {
        /// Which one.
        pick: Extreme,
        /// One end of the search.
        from: PointReference,
        /// Other end of the search.
        to: PointReference,
        /// Where the tape goes.
        tape: Tape,
    },
    /// Volume enclosed by the surface.
    Volume {},
}

/// One measurement's definition.
#[derive(Clone, Debug, PartialEq)]
pub struct Definition {
    /// Its name.
    pub name: String,
    /// How it is taken.
    pub method: Method,
    /// What it is, in words.
    pub definition: String,
}

impl Definition {
    /// Apart from name and words, the table is the method's: so an unknown key is noticed.
    fn from_table(template: &toml::Table, side: &str) -> Result<Self, DefinitionsError> {
        let mut table: toml::Table =
            template.iter().map(|(key, value)| (key.clone(), with_side(value, side))).collect();
        let mut text = |key: &'static str| match table.remove(key) {
            Some(toml::Value::String(text)) if !text.is_empty() => Ok(text),
            _ => Err(DefinitionsError::NoText { key }),
        };
        let (name, definition) = (text("name")?, text("definition")?);
        let method = toml::Value::Table(table)
            .try_into()
            .map_err(|source| DefinitionsError::Unusable { name: name.clone(), source })?;
        Ok(Self { name, method, definition })
    }
}

/// A set of definitions.
#[derive(Clone, Debug, PartialEq)]
pub struct Definitions {
    /// The definitions in the order of the table.
    pub measurements: Vec<Definition>,
}

impl Definitions {
    /// The embedded set.
    pub fn standard() -> Result<Self, DefinitionsError> {
        Self::from_toml(include_str!("definitions.toml"))
    }

    /// Reads a set; a measurement with `{side}` in its name stands for a left and a right one.
    pub fn from_toml(text: &str) -> Result<Self, DefinitionsError> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct DefinitionsFile {
            version: i64,
            measurement: Vec<toml::Table>,
        }
        let file: DefinitionsFile = toml::from_str(text)?;
        if file.version > VERSION {
            return Err(DefinitionsError::Newer { found: file.version });
        }
        let mut measurements: Vec<Definition> = Vec::new();
        for template in file.measurement {
            let name = template.get("name").and_then(toml::Value::as_str).unwrap_or_default();
            let sides: &[&str] = if name.contains("{side}") { &SIDES } else { &[""] };
            for side in sides {
                let definition = Definition::from_table(&template, side)?;
                if measurements.iter().any(|earlier| earlier.name == definition.name) {
                    return Err(DefinitionsError::Duplicate { name: definition.name });
                }
                measurements.push(definition);
            }
        }
        Ok(Self { measurements })
    }
}

/// The same value with `{side}` replaced in every text.
fn with_side(value: &toml::Value, side: &str) -> toml::Value {
    match value {
        toml::Value::String(text) => text.replace("{side}", side).into(),
        toml::Value::Array(items) => {
            toml::Value::Array(items.iter().map(|item| with_side(item, side)).collect())
        }
        toml::Value::Table(table) => {
            toml::Value::Table(table.iter().map(|(key, item)| (key.clone(), with_side(item, side))).collect())
        }
        other => other.clone(),
    }
}
