//! The binary container of glTF 2.0 (specification §4) and the parts that every content needs: buffer views and accessors.
//!
//! [`GlbBuilder`] collects binary data and its description; the caller adds meshes, nodes, skins and animations as JSON.

use serde_json::{Map, Value, json};

use super::Format;
use super::error::{ContentError, Fault, Place, Problem};

const MAGIC: &[u8] = b"glTF";
const VERSION: u32 = 2;
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BINARY_CHUNK: u32 = 0x004E_4942;
/// The container's header, and the header of each chunk.
const HEADER_SIZE: usize = 12;
const CHUNK_HEADER_SIZE: usize = 8;

/// glTF's code for 8-bit whole numbers.
pub const UNSIGNED_BYTE: u32 = 5121;
/// glTF's code for 16-bit whole numbers.
pub const UNSIGNED_SHORT: u32 = 5123;
/// glTF's code for 32-bit whole numbers.
pub const UNSIGNED_INT: u32 = 5125;
/// glTF's code for 32-bit floats.
pub const FLOAT: u32 = 5126;

/// What a buffer view is for, where the renderer wants to know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ViewTarget {
    /// Vertex attributes.
    Vertices,
    /// Vertex indices.
    Indices,
    /// Anything else: matrices of a skin, keys of an animation.
    Other,
}

/// Collects binary data with its buffer views and accessors, and packs them with the rest of the description.
#[derive(Debug, Clone, Default)]
pub struct GlbBuilder {
    binary: Vec<u8>,
    buffer_views: Vec<Value>,
    accessors: Vec<Value>,
}

impl GlbBuilder {
    /// An empty container.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds elements of `LANES` 32-bit floats (`SCALAR`, `VEC4`, `MAT4` …); gives the accessor's index.
    /// Its bounds are written too, as positions and animation times need them.
    pub fn add_floats<const LANES: usize>(
        &mut self,
        kind: &'static str,
        target: ViewTarget,
        elements: &[[f32; LANES]],
    ) -> usize {
        let (mut lowest, mut highest) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
        for element in elements {
            for (lane, value) in element.iter().enumerate() {
                lowest[lane] = lowest[lane].min(*value);
                highest[lane] = highest[lane].max(*value);
            }
        }
        let bytes = elements.iter().flatten().flat_map(|value| value.to_le_bytes());
        let accessor = self.add_accessor(kind, FLOAT, elements.len(), target, bytes);
        if !elements.is_empty() {
            self.accessors[accessor]["min"] = json!(lowest.as_slice());
            self.accessors[accessor]["max"] = json!(highest.as_slice());
        }
        accessor
    }

    /// Adds positions, directions or translations of three floats each.
    pub fn add_vectors(&mut self, target: ViewTarget, vectors: &[[f32; 3]]) -> usize {
        self.add_floats("VEC3", target, vectors)
    }

    /// Adds vertex indices as 32-bit whole numbers.
    pub fn add_indices(&mut self, faces: &[[u32; 3]]) -> usize {
        let bytes = faces.iter().flatten().flat_map(|vertex| vertex.to_le_bytes());
        self.add_accessor("SCALAR", UNSIGNED_INT, 3 * faces.len(), ViewTarget::Indices, bytes)
    }

    /// Adds elements of any kind (`SCALAR`, `VEC4`, `MAT4` …) and component type, given as little-endian bytes;
    /// vertex attributes must take a multiple of four bytes each.
    pub fn add_accessor(
        &mut self,
        kind: &'static str,
        component_type: u32,
        element_count: usize,
        target: ViewTarget,
        bytes: impl IntoIterator<Item = u8>,
    ) -> usize {
        let start = self.binary.len();
        self.binary.extend(bytes);
        let mut view = json!({ "buffer": 0, "byteOffset": start, "byteLength": self.binary.len() - start });
        match target {
            ViewTarget::Vertices => view["target"] = json!(34962),
            ViewTarget::Indices => view["target"] = json!(34963),
            ViewTarget::Other => {}
        }
        self.buffer_views.push(view);
        // Every accessor begins at a multiple of its component's size; four serves all.
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        self.accessors.push(json!({
            "bufferView": self.buffer_views.len() - 1,
            "componentType": component_type,
            "count": element_count,
            "type": kind,
        }));
        self.accessors.len() - 1
    }

    /// Marks whole numbers as standing for the range 0 to 1, as colours and skin weights may.
    pub fn mark_normalized(&mut self, accessor: usize) {
        self.accessors[accessor]["normalized"] = json!(true);
    }

    /// The bytes of the file; `description` holds everything but `asset`, `buffers`, `bufferViews` and `accessors`.
    pub fn finish(self, mut description: Map<String, Value>) -> Result<Vec<u8>, ContentError> {
        description.insert("asset".into(), json!({ "version": "2.0", "generator": "habitus" }));
        if !self.binary.is_empty() {
            description.insert("buffers".into(), json!([{ "byteLength": self.binary.len() }]));
            description.insert("bufferViews".into(), Value::Array(self.buffer_views));
            description.insert("accessors".into(), Value::Array(self.accessors));
        }
        let mut text = Value::Object(description).to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');

        let byte_count = HEADER_SIZE + 2 * CHUNK_HEADER_SIZE + text.len() + self.binary.len();
        let length = |count: usize| {
            u32::try_from(count).map(u32::to_le_bytes).map_err(|_| ContentError::TooLarge { byte_count })
        };
        let mut bytes = Vec::with_capacity(byte_count);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&length(byte_count)?);
        for (kind, chunk) in [(JSON_CHUNK, &text), (BINARY_CHUNK, &self.binary)] {
            bytes.extend_from_slice(&length(chunk.len())?);
            bytes.extend_from_slice(&kind.to_le_bytes());
            bytes.extend_from_slice(chunk);
        }
        Ok(bytes)
    }
}

/// A container taken apart.
pub(super) struct Container<'a> {
    pub description: Value,
    pub binary: &'a [u8],
}

impl<'a> Container<'a> {
    pub fn parse(bytes: &'a [u8]) -> Result<Self, Fault> {
        let fault = |byte: usize, problem| Fault { place: Place::Byte(byte), problem };
        if !bytes.starts_with(MAGIC) {
            return Err(fault(0, Problem::WrongStart { looks_like: Format::sniff(bytes) }));
        }
        let ends = |byte: usize| fault(byte, Problem::EndsInside { part: "container header" });
        let version = number_at(bytes, 4).ok_or_else(|| ends(bytes.len()))?;
        if version != VERSION {
            let what = format!("glTF version {version}");
            return Err(fault(4, Problem::Unsupported { what, remedy: "save as glTF 2.0" }));
        }
        let declared = number_at(bytes, 8).ok_or_else(|| ends(bytes.len()))? as usize;
        if declared > bytes.len() {
            return Err(fault(bytes.len(), Problem::EndsInside { part: "declared length" }));
        }
        let bytes = &bytes[..declared];
        let (mut description, mut binary): (_, &[u8]) = (None, &[]);
        let mut offset = HEADER_SIZE;
        while offset < bytes.len() {
            let ends = || fault(bytes.len(), Problem::EndsInside { part: "last chunk" });
            let length = number_at(bytes, offset).ok_or_else(ends)? as usize;
            let kind = number_at(bytes, offset + 4).ok_or_else(ends)?;
            let start = offset + CHUNK_HEADER_SIZE;
            let chunk = start.checked_add(length).and_then(|end| bytes.get(start..end)).ok_or_else(ends)?;
            match kind {
                JSON_CHUNK if description.is_none() => {
                    let parsed = serde_json::from_slice(chunk).map_err(|error| {
                        let found = error.to_string();
                        fault(start, Problem::Unexpected { expected: "a description in JSON", found })
                    })?;
                    description = Some(parsed);
                }
                BINARY_CHUNK if binary.is_empty() => binary = chunk,
                // The specification tells readers to skip chunks that they do not know.
                _ => {}
            }
            offset = start + length;
        }
        let missing = || fault(HEADER_SIZE, Problem::Missing { what: "the JSON chunk".to_owned() });
        Ok(Self { description: description.ok_or_else(missing)?, binary })
    }
}

fn number_at(bytes: &[u8], offset: usize) -> Option<u32> {
    bytes.get(offset..)?.first_chunk().map(|number| u32::from_le_bytes(*number))
}
