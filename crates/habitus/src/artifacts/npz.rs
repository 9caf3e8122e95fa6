//! Named arrays in one `.npz` file that plain numpy reads and writes.

use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};

use half::f16;
use npyz::{DType, NpyFile, Order, TypeChar, WriterBuilder};
use thiserror::Error;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Why an `.npz` file cannot be used.
#[derive(Debug, Error)]
pub enum NpzError {
    /// The container is broken.
    #[error("{}: not a readable .npz archive ({reason}); it may be truncated, write it again", path.display())]
    Archive {
        /// The file.
        path: PathBuf,
        /// What the archive reader says.
        reason: String,
    },
    /// An array is not there.
    #[error("{}: array '{key}' is missing", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The array's name.
        key: String,
    },
    /// An array is there but unusable.
    #[error("{}: array '{key}' is unusable: {reason}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// The array's name.
        key: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The file cannot be written.
    #[error("{}: cannot be written ({reason})", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What failed.
        reason: String,
    },
}

/// An array in C order.
#[derive(Clone, Debug, PartialEq)]
pub struct Array<T> {
    /// Lengths of the axes.
    pub shape: Vec<usize>,
    /// Values, last axis fastest.
    pub values: Vec<T>,
}

/// No array of ours comes near this; a hostile archive that inflates further is refused.
const LARGEST_ARRAY_BYTES: u64 = 1 << 30;

/// An open archive, held in memory.
pub struct NpzReader {
    path: PathBuf,
    archive: ZipArchive<Cursor<Vec<u8>>>,
}

impl NpzReader {
    /// Opens an archive that is in memory; `path` is for messages.
    pub fn new(bytes: Vec<u8>, path: &Path) -> Result<Self, NpzError> {
        let archive = ZipArchive::new(Cursor::new(bytes))
            .map_err(|error| NpzError::Archive { path: path.to_path_buf(), reason: error.to_string() })?;
        Ok(Self { path: path.to_path_buf(), archive })
    }

    /// Whether an array is there.
    pub fn contains(&self, key: &str) -> bool {
        self.archive.index_for_name(&format!("{key}.npy")).is_some()
    }

    /// Reads a floating-point array (f2, f4, f8 or any integer type).
    pub fn floats(&mut self, key: &str) -> Result<Array<f64>, NpzError> {
        let array = self.numbers(key)?;
        match array.values.iter().position(|value| !value.is_finite()) {
            None => Ok(array),
            Some(index) => Err(self.invalid(key, format!("element {index} is not a finite number"))),
        }
    }

    /// Reads an integer array of values in `0..limit`.
    pub fn indices(&mut self, key: &str, limit: usize) -> Result<Array<u32>, NpzError> {
        let array = self.integers(key)?;
        let mut values = Vec::with_capacity(array.values.len());
        for (position, value) in array.values.iter().enumerate() {
            match u32::try_from(*value) {
                Ok(index) if (index as usize) < limit => values.push(index),
                _ => {
                    return Err(
                        self.invalid(key, format!("element {position} is {value}, outside 0..{limit}"))
                    );
                }
            }
        }
        Ok(Array { shape: array.shape, values })
    }

    /// Reads an integer array.
    pub fn integers(&mut self, key: &str) -> Result<Array<i64>, NpzError> {
        let array = self.numbers(key)?;
        let values = array.values.iter().map(|value| *value as i64).collect();
        if array.values.iter().any(|value| value.fract() != 0.0) {
            return Err(self.invalid(key, "holds fractions where whole numbers are needed".into()));
        }
        Ok(Array { shape: array.shape, values })
    }

    /// Reads an array of bytes that holds UTF-8 text.
    pub fn text(&mut self, key: &str) -> Result<String, NpzError> {
        let array = self.integers(key)?;
        let bytes: Option<Vec<u8>> = array.values.iter().map(|value| u8::try_from(*value).ok()).collect();
        bytes
            .and_then(|bytes| String::from_utf8(bytes).ok())
            .ok_or_else(|| self.invalid(key, "is not UTF-8 text".into()))
    }

    /// Fails unless the array has this shape; `None` stands for any length.
    pub fn expect_shape<T>(
        &self,
        key: &str,
        array: &Array<T>,
        shape: &[Option<usize>],
    ) -> Result<(), NpzError> {
        let matches = array.shape.len() == shape.len()
            && array.shape.iter().zip(shape).all(|(found, wanted)| wanted.is_none_or(|w| w == *found));
        if matches {
            return Ok(());
        }
        let wanted: Vec<String> =
            shape.iter().map(|n| n.map_or_else(|| "any".into(), |n| n.to_string())).collect();
        Err(self.invalid(key, format!("has shape {:?}, needs ({})", array.shape, wanted.join(", "))))
    }

    /// An error about one array of this file.
    pub fn invalid(&self, key: &str, reason: String) -> NpzError {
        NpzError::Invalid { path: self.path.clone(), key: key.into(), reason }
    }

    fn numbers(&mut self, key: &str) -> Result<Array<f64>, NpzError> {
        let bytes = self.member(key)?;
        let fail = |reason: String| NpzError::Invalid { path: self.path.clone(), key: key.into(), reason };
        let Some(data_start) = start_of_data(&bytes) else {
            return Err(fail("claims more elements than can be counted, or has no readable header".into()));
        };
        let file = NpyFile::new(&bytes[..]).map_err(|error| fail(error.to_string()))?;
        if file.header().order() != Order::C {
            return Err(fail("is in Fortran order; save it with numpy.ascontiguousarray".into()));
        }
        let DType::Plain(kind) = file.header().dtype() else {
            return Err(fail("is a record array; plain numbers are needed".into()));
        };
        let shape: Vec<usize> = file.shape().iter().map(|n| *n as usize).collect();
        // The header's count is only a claim: it must agree with the bytes before anything is reserved.
        let count = shape.iter().try_fold(1_usize, |product, n| product.checked_mul(*n));
        let item = kind.size_field() as usize;
        match count.and_then(|count| count.checked_mul(item)) {
            Some(size) if size <= bytes.len() - data_start => {}
            _ => {
                return Err(fail(format!(
                    "claims shape {shape:?} but holds {} bytes",
                    bytes.len() - data_start
                )));
            }
        }
        macro_rules! read {
            ($type:ty, $convert:expr) => {
                file.data::<$type>()
                    .map_err(|error| fail(error.to_string()))?
                    .map(|value| value.map($convert))
                    .collect::<Result<Vec<f64>, _>>()
                    .map_err(|error| fail(error.to_string()))?
            };
        }
        let values = match (kind.type_char(), item) {
            (TypeChar::Float, 2) => read!(f16, |value| value.to_f64()),
            (TypeChar::Float, 4) => read!(f32, f64::from),
            (TypeChar::Float, 8) => read!(f64, |value| value),
            (TypeChar::Int, 1) => read!(i8, f64::from),
            (TypeChar::Int, 2) => read!(i16, f64::from),
            (TypeChar::Int, 4) => read!(i32, f64::from),
            (TypeChar::Int, 8) => read!(i64, |value| value as f64),
            (TypeChar::Uint, 1) => read!(u8, f64::from),
            (TypeChar::Uint, 2) => read!(u16, f64::from),
            (TypeChar::Uint, 4) => read!(u32, f64::from),
            (TypeChar::Uint, 8) => read!(u64, |value| value as f64),
            (TypeChar::Bool, 1) => read!(bool, |value| f64::from(u8::from(value))),
            _ => return Err(fail(format!("has the unsupported type {kind}"))),
        };
        Ok(Array { shape, values })
    }

    fn member(&mut self, key: &str) -> Result<Vec<u8>, NpzError> {
        let name = format!("{key}.npy");
        let Some(index) = self.archive.index_for_name(&name) else {
            return Err(NpzError::Missing { path: self.path.clone(), key: key.into() });
        };
        let broken = |path: &Path, reason: String| NpzError::Archive { path: path.to_path_buf(), reason };
        let member = self.archive.by_index(index).map_err(|error| broken(&self.path, error.to_string()))?;
        let mut bytes = Vec::new();
        member
            .take(LARGEST_ARRAY_BYTES)
            .read_to_end(&mut bytes)
            .map_err(|error| broken(&self.path, format!("array '{key}': {error}")))?;
        Ok(bytes)
    }
}

/// Where the data of a numpy array begin, if the numbers in its header (item size and shape among them) can be
/// multiplied. Checked before the header goes to its parser, which multiplies without a check.
fn start_of_data(bytes: &[u8]) -> Option<usize> {
    let start = match bytes {
        [_, _, _, _, _, _, 1, _, a, b, ..] => 10 + usize::from(u16::from_le_bytes([*a, *b])),
        [_, _, _, _, _, _, _, _, a, b, c, d, ..] => 12 + u32::from_le_bytes([*a, *b, *c, *d]) as usize,
        _ => return None,
    };
    bytes.get(10..start)?.split(|byte| !byte.is_ascii_digit()).filter(|digits| !digits.is_empty()).try_fold(
        1_usize,
        |product, digits| {
            let number: usize = std::str::from_utf8(digits).ok()?.parse().ok()?;
            product.checked_mul(number.max(1))
        },
    )?;
    Some(start)
}

/// Collects arrays and writes them as one archive.
pub struct NpzWriter {
    archive: ZipWriter<Cursor<Vec<u8>>>,
    failure: Option<String>,
}

impl Default for NpzWriter {
    fn default() -> Self {
        Self::new()
    }
}

impl NpzWriter {
    /// An empty archive.
    pub fn new() -> Self {
        Self { archive: ZipWriter::new(Cursor::new(Vec::new())), failure: None }
    }

    /// Adds an array; a failure is kept and reported by `finish`.
    pub fn add<T: npyz::AutoSerialize + Copy>(&mut self, key: &str, shape: &[usize], values: &[T]) {
        if let Err(reason) = self.try_add(key, shape, values) {
            self.failure.get_or_insert(format!("array '{key}': {reason}"));
        }
    }

    /// Adds UTF-8 text as an array of bytes.
    pub fn add_text(&mut self, key: &str, text: &str) {
        self.add(key, &[text.len()], text.as_bytes());
    }

    fn try_add<T: npyz::AutoSerialize + Copy>(
        &mut self,
        key: &str,
        shape: &[usize],
        values: &[T],
    ) -> Result<(), String> {
        let shape: Vec<u64> = shape.iter().map(|n| *n as u64).collect();
        if shape.iter().product::<u64>() != values.len() as u64 {
            return Err(format!("shape {shape:?} does not hold {} values", values.len()));
        }
        let mut bytes = Vec::new();
        let mut writer = npyz::WriteOptions::new()
            .default_dtype()
            .shape(&shape)
            .writer(&mut bytes)
            .begin_nd()
            .map_err(|error| error.to_string())?;
        for value in values {
            writer.push(value).map_err(|error| error.to_string())?;
        }
        writer.finish().map_err(|error| error.to_string())?;
        // A fixed time stamp keeps equal results equal to the byte.
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .last_modified_time(zip::DateTime::default())
            .large_file(bytes.len() as u64 > u64::from(u32::MAX) / 2);
        self.archive.start_file(format!("{key}.npy"), options).map_err(|error| error.to_string())?;
        self.archive.write_all(&bytes).map_err(|error| error.to_string())
    }

    /// The finished archive.
    pub fn into_bytes(self) -> Result<Vec<u8>, String> {
        if let Some(failure) = self.failure {
            return Err(failure);
        }
        self.archive.finish().map(Cursor::into_inner).map_err(|error| error.to_string())
    }

    /// Writes the archive under a temporary name and renames it, so that a kill leaves no half file.
    pub fn write(self, path: &Path) -> Result<(), NpzError> {
        let fail = |reason: String| NpzError::Write { path: path.to_path_buf(), reason };
        let bytes = self.into_bytes().map_err(&fail)?;
        super::write_atomically(path, &bytes).map_err(|error| fail(error.to_string()))
    }
}

#[cfg(test)]
mod tests;
