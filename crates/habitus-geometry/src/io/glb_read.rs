//! Reads the triangles of a GLB file: all meshes of the default scene, moved by their nodes.
//!
//! Skinned meshes come as they were bound: glTF §3.7.3.3 ignores their node's transform, and no animation is played.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};
use serde_json::Value;

use super::Format;
use super::content::Content;
use super::error::{Fault, Place, Problem};
use super::glb::{Container, FLOAT, UNSIGNED_BYTE, UNSIGNED_INT, UNSIGNED_SHORT};

/// Reads positions and triangles of every mesh that a node shows.
pub(super) fn read(bytes: &[u8]) -> Result<Content, Fault> {
    let container = Container::parse(bytes)?;
    let gltf = Gltf { root: &container.description, binary: container.binary };
    gltf.check_header()?;
    let mut content = Content::new(Format::Glb);
    // Every place of a mesh costs memory, so a small file must not show a large mesh a million times.
    let size_limit = bytes.len();
    for (mesh, placed) in gltf.placed_meshes()? {
        gltf.add_mesh(mesh, placed, size_limit, &mut content)?;
    }
    content.finish(Place::Byte(bytes.len()))
}

struct Gltf<'a> {
    root: &'a Value,
    binary: &'a [u8],
}

/// An accessor whose range was checked against the binary chunk.
struct Elements<'a> {
    bytes: &'a [u8],
    count: usize,
    stride: usize,
    component_type: u32,
}

impl<'a> Gltf<'a> {
    fn check_header(&self) -> Result<(), Fault> {
        let version = self.root["asset"]["version"].as_str().unwrap_or_default();
        if !version.starts_with("2.") {
            let what = "the asset version 2.x".to_owned();
            return Err(fault("asset", 0, Problem::Missing { what }));
        }
        let required = self.list("extensionsRequired").iter().enumerate();
        for (index, name) in required {
            let name = name.as_str().unwrap_or_default();
            if !name.starts_with("KHR_materials_") && !name.starts_with("KHR_texture_") {
                let what = format!("the glTF extension {name}");
                let problem =
                    Problem::Unsupported { what, remedy: "export without compression and extensions" };
                return Err(fault("extensionsRequired", index, problem));
            }
        }
        Ok(())
    }

    fn list(&self, name: &str) -> &'a [Value] {
        self.root[name].as_array().map_or(&[], Vec::as_slice)
    }

    fn object(&self, list: &'static str, index: usize) -> Result<&'a Value, Fault> {
        self.list(list)
            .get(index)
            .ok_or_else(|| missing(list, index, "the object itself, which another names,"))
    }

    /// Every mesh that the default scene shows, with its transform.
    fn placed_meshes(&self) -> Result<Vec<(usize, DAffine3)>, Fault> {
        let nodes = self.list("nodes");
        if nodes.is_empty() {
            return Ok((0..self.list("meshes").len()).map(|mesh| (mesh, DAffine3::IDENTITY)).collect());
        }
        let mut waiting: Vec<(usize, DAffine3)> =
            self.root_nodes()?.into_iter().rev().map(|node| (node, DAffine3::IDENTITY)).collect();
        let mut is_visited = vec![false; nodes.len()];
        let mut placed = Vec::new();
        while let Some((index, parent)) = waiting.pop() {
            let node = self.object("nodes", index)?;
            if std::mem::replace(&mut is_visited[index], true) {
                let what = "the node as a child (nodes must form a tree)".to_owned();
                return Err(fault("nodes", index, Problem::Repeated { what }));
            }
            let transform = parent * local_transform(node, index)?;
            if let Some(mesh) = optional_index(node, "mesh", "nodes", index)? {
                let is_skinned = !node["skin"].is_null();
                placed.push((mesh, if is_skinned { DAffine3::IDENTITY } else { transform }));
            }
            let children = indices_of(&node["children"], "nodes", index)?;
            waiting.extend(children.into_iter().rev().map(|child| (child, transform)));
        }
        Ok(placed)
    }

    /// The default scene's nodes, or those that no other node has as a child.
    fn root_nodes(&self) -> Result<Vec<usize>, Fault> {
        if !self.list("scenes").is_empty() {
            let scene = optional_index(self.root, "scene", "scenes", 0)?.unwrap_or(0);
            return indices_of(&self.object("scenes", scene)?["nodes"], "scenes", scene);
        }
        let mut is_root = vec![true; self.list("nodes").len()];
        for (index, node) in self.list("nodes").iter().enumerate() {
            for child in indices_of(&node["children"], "nodes", index)? {
                if let Some(is_root) = is_root.get_mut(child) {
                    *is_root = false;
                }
            }
        }
        Ok((0..is_root.len()).filter(|&node| is_root[node]).collect())
    }

    fn add_mesh(
        &self,
        mesh: usize,
        placed: DAffine3,
        size_limit: usize,
        content: &mut Content,
    ) -> Result<(), Fault> {
        let primitives = self.object("meshes", mesh)?["primitives"]
            .as_array()
            .ok_or_else(|| missing("meshes", mesh, "`primitives`"))?;
        // Parts of one mesh often share their vertices and differ in material only.
        let mut first_vertices = HashMap::new();
        for primitive in primitives {
            if !primitive["extensions"]["KHR_draco_mesh_compression"].is_null() {
                let what = "Draco compression".to_owned();
                let problem = Problem::Unsupported { what, remedy: "export without compression" };
                return Err(fault("meshes", mesh, problem));
            }
            let accessor = optional_index(&primitive["attributes"], "POSITION", "meshes", mesh)?
                .ok_or_else(|| missing("meshes", mesh, "the attribute POSITION"))?;
            let place = Place::Object("accessors", accessor);
            let positions = self.elements(accessor, "VEC3", &[FLOAT])?;
            let first_vertex = match first_vertices.get(&accessor) {
                Some(&first_vertex) => first_vertex,
                None => {
                    let first_vertex = content.positions.len() as u32;
                    if content.positions.len().saturating_add(positions.count) > size_limit {
                        let what = "more vertices than the file has bytes".to_owned();
                        let problem = Problem::Unsupported { what, remedy: "export without instances" };
                        return Err(Fault { place, problem });
                    }
                    for index in 0..positions.count {
                        content.add_position(placed.transform_point3(positions.vector(index)), place)?;
                    }
                    first_vertices.insert(accessor, first_vertex);
                    first_vertex
                }
            };
            let mode = optional_index(primitive, "mode", "meshes", mesh)?.unwrap_or(4);
            let indices = match optional_index(primitive, "indices", "meshes", mesh)? {
                Some(accessor) => self.indices(accessor, positions.count, content.report.polygon_count)?,
                None => (0..positions.count as u32).collect(),
            };
            let flips = placed.matrix3.determinant() < 0.0;
            let triangles = triangles(mode, &indices, mesh)?;
            if content.faces.len().saturating_add(triangles.len()) > size_limit {
                let what = "more triangles than the file has bytes".to_owned();
                let problem = Problem::Unsupported { what, remedy: "export without shared indices" };
                return Err(Fault { place, problem });
            }
            for mut triangle in triangles {
                if flips {
                    // A mirror turns the winding, and with it the outside.
                    triangle.swap(1, 2);
                }
                content.add_polygon(&triangle.map(|vertex| first_vertex + vertex), place);
            }
        }
        Ok(())
    }

    fn indices(&self, accessor: usize, vertex_count: usize, first_face: usize) -> Result<Vec<u32>, Fault> {
        let elements = self.elements(accessor, "SCALAR", &[UNSIGNED_BYTE, UNSIGNED_SHORT, UNSIGNED_INT])?;
        (0..elements.count)
            .map(|index| {
                let vertex = elements.index(index);
                if (vertex as usize) < vertex_count {
                    return Ok(vertex);
                }
                let problem = Problem::VertexOutOfRange {
                    face: first_face + index / 3,
                    vertex: i64::from(vertex),
                    vertex_count,
                };
                Err(fault("accessors", accessor, problem))
            })
            .collect()
    }

    /// The elements of an accessor of the wanted kind, all of them within the binary chunk.
    fn elements(
        &self,
        index: usize,
        kind: &'static str,
        component_types: &[u32],
    ) -> Result<Elements<'a>, Fault> {
        let accessor = self.object("accessors", index)?;
        let unsupported = |what: &str, remedy| {
            fault("accessors", index, Problem::Unsupported { what: what.to_owned(), remedy })
        };
        if !accessor["sparse"].is_null() {
            return Err(unsupported("a sparse accessor", "export without sparse accessors"));
        }
        let component_type = accessor["componentType"].as_u64().unwrap_or_default();
        let Some(&component_type) = component_types.iter().find(|&&known| u64::from(known) == component_type)
        else {
            let what = format!("component type {component_type} for {kind} here");
            return Err(unsupported(&what, "export with float positions and unsigned indices"));
        };
        if accessor["type"].as_str() != Some(kind) {
            let found = accessor["type"].to_string();
            return Err(fault("accessors", index, Problem::Unexpected { expected: kind, found }));
        }
        let count = optional_index(accessor, "count", "accessors", index)?
            .ok_or_else(|| missing("accessors", index, "`count`"))?;
        let offset = optional_index(accessor, "byteOffset", "accessors", index)?.unwrap_or(0);
        let (view, stride) = match optional_index(accessor, "bufferView", "accessors", index)? {
            Some(view) => self.buffer_view(view)?,
            None => return Err(unsupported("an accessor without data", "export the mesh with its data")),
        };
        let lanes = if kind == "VEC3" { 3 } else { 1 };
        let size = lanes * component_size(component_type);
        let stride = stride.unwrap_or(size);
        let too_long = |possible: usize| {
            let element = "element".to_owned();
            let problem =
                Problem::CountBeyondFile { element, declared: count as u64, possible: possible as u64 };
            fault("accessors", index, problem)
        };
        let bytes = view.get(offset..).ok_or_else(|| too_long(0))?;
        if stride < size {
            let found = stride.to_string();
            let problem = Problem::Unexpected { expected: "a stride of a whole element or more", found };
            return Err(fault("accessors", index, problem));
        }
        let possible = if bytes.len() < size { 0 } else { (bytes.len() - size) / stride + 1 };
        if count > possible {
            return Err(too_long(possible));
        }
        Ok(Elements { bytes, count, stride, component_type })
    }

    /// The bytes of a buffer view and its stride, if it has one.
    fn buffer_view(&self, index: usize) -> Result<(&'a [u8], Option<usize>), Fault> {
        let view = self.object("bufferViews", index)?;
        let number = |name| optional_index(view, name, "bufferViews", index);
        let buffer = number("buffer")?.ok_or_else(|| missing("bufferViews", index, "`buffer`"))?;
        let is_external = !self.object("buffers", buffer)?["uri"].is_null();
        if is_external || buffer != 0 {
            let what = "a buffer outside the file".to_owned();
            return Err(fault(
                "buffers",
                buffer,
                Problem::Unsupported { what, remedy: "save everything into one .glb" },
            ));
        }
        let start = number("byteOffset")?.unwrap_or(0);
        let length = number("byteLength")?.ok_or_else(|| missing("bufferViews", index, "`byteLength`"))?;
        let end = start.checked_add(length);
        let bytes = end.and_then(|end| self.binary.get(start..end)).ok_or_else(|| {
            let problem = Problem::CountBeyondFile {
                element: "byte".to_owned(),
                declared: (start as u64).saturating_add(length as u64),
                possible: self.binary.len() as u64,
            };
            fault("bufferViews", index, problem)
        })?;
        Ok((bytes, number("byteStride")?))
    }
}

impl Elements<'_> {
    fn component<const SIZE: usize>(&self, index: usize, lane: usize) -> [u8; SIZE] {
        // In range by the checks in `Gltf::elements`.
        self.bytes[index * self.stride + lane * SIZE..].first_chunk().copied().unwrap_or([0; SIZE])
    }

    fn vector(&self, index: usize) -> DVec3 {
        DVec3::from([0, 1, 2].map(|lane| f64::from(f32::from_le_bytes(self.component(index, lane)))))
    }

    fn index(&self, index: usize) -> u32 {
        match self.component_type {
            UNSIGNED_BYTE => u32::from(u8::from_le_bytes(self.component(index, 0))),
            UNSIGNED_SHORT => u32::from(u16::from_le_bytes(self.component(index, 0))),
            _ => u32::from_le_bytes(self.component(index, 0)),
        }
    }
}

fn component_size(component_type: u32) -> usize {
    match component_type {
        UNSIGNED_BYTE => 1,
        UNSIGNED_SHORT => 2,
        _ => 4,
    }
}

/// The triangles of a primitive: lists, strips and fans; points have none.
fn triangles(mode: usize, indices: &[u32], mesh: usize) -> Result<Vec<[u32; 3]>, Fault> {
    Ok(match mode {
        0 => Vec::new(),
        4 if !indices.len().is_multiple_of(3) => {
            let problem = Problem::EndsEarly {
                element: "triangle".to_owned(),
                index: indices.len() / 3,
                declared: indices.len() / 3 + 1,
            };
            return Err(fault("meshes", mesh, problem));
        }
        4 => indices.chunks_exact(3).map(|corners| [corners[0], corners[1], corners[2]]).collect(),
        5 => indices
            .windows(3)
            .enumerate()
            .map(|(place, w)| if place % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
            .collect(),
        6 => indices.get(1..).unwrap_or_default().windows(2).map(|w| [indices[0], w[0], w[1]]).collect(),
        _ => {
            let what = format!("the drawing mode {mode} (lines)");
            return Err(fault(
                "meshes",
                mesh,
                Problem::Unsupported { what, remedy: "export triangles only" },
            ));
        }
    })
}

fn local_transform(node: &Value, index: usize) -> Result<DAffine3, Fault> {
    let numbers = |name: &'static str, count: usize| -> Result<Option<Vec<f64>>, Fault> {
        if node[name].is_null() {
            return Ok(None);
        }
        let numbers: Option<Vec<f64>> =
            node[name].as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
        let wrong = || {
            let problem = Problem::Unexpected {
                expected: "a list of numbers of the right length",
                found: name.to_owned(),
            };
            fault("nodes", index, problem)
        };
        numbers.filter(|list| list.len() == count).map(Some).ok_or_else(wrong)
    };
    if let Some(matrix) = numbers("matrix", 16)? {
        let matrix = DMat4::from_cols_slice(&matrix);
        return Ok(DAffine3::from_mat4(matrix));
    }
    let translation = numbers("translation", 3)?.map_or(DVec3::ZERO, |list| DVec3::from_slice(&list));
    let scale = numbers("scale", 3)?.map_or(DVec3::ONE, |list| DVec3::from_slice(&list));
    let rotation = match numbers("rotation", 4)? {
        Some(list) => {
            let turn = DQuat::from_slice(&list);
            let problem =
                Problem::Unexpected { expected: "a rotation of length 1", found: format!("{list:?}") };
            if !(turn.length() - 1.0).abs().le(&1e-2) {
                return Err(fault("nodes", index, problem));
            }
            turn.normalize()
        }
        None => DQuat::IDENTITY,
    };
    Ok(DAffine3 { matrix3: DMat3::from_quat(rotation) * DMat3::from_diagonal(scale), translation })
}

fn fault(list: &'static str, index: usize, problem: Problem) -> Fault {
    Fault { place: Place::Object(list, index), problem }
}

fn missing(list: &'static str, index: usize, what: &str) -> Fault {
    fault(list, index, Problem::Missing { what: what.to_owned() })
}

/// A whole number of an object, if it is there.
fn optional_index(
    object: &Value,
    name: &'static str,
    list: &'static str,
    index: usize,
) -> Result<Option<usize>, Fault> {
    match &object[name] {
        Value::Null => Ok(None),
        value => whole(value, list, index).map(Some),
    }
}

fn indices_of(value: &Value, list: &'static str, index: usize) -> Result<Vec<usize>, Fault> {
    value.as_array().map_or(&[][..], Vec::as_slice).iter().map(|value| whole(value, list, index)).collect()
}

fn whole(value: &Value, list: &'static str, index: usize) -> Result<usize, Fault> {
    value.as_u64().and_then(|number| usize::try_from(number).ok()).ok_or_else(|| {
        let problem =
            Problem::Unexpected { expected: "a whole number of 0 or more", found: value.to_string() };
        fault(list, index, problem)
    })
}
