//! The binary part of a glTF file: typed arrays, their accessors and the container around them.

use super::ExportError;
use glam::DVec3;
use gltf_json::{
    Accessor, Buffer, Image, Index, Root, Value,
    accessor::{ComponentType, GenericComponentType, Type},
    buffer::{Stride, Target, View},
    image::MimeType,
    validation::{Checked, USize64},
};

/// What an array is used for; each use has its own buffer view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Use {
    Vertices,
    Triangles,
    Keyframes,
    Places,
    Scalars,
}

/// Arrays on their way into one buffer.
#[derive(Debug, Default)]
pub(super) struct Arrays {
    vertices: Vec<u8>,
    triangles: Vec<u8>,
    keyframes: Vec<u8>,
    places: Vec<u8>,
    scalars: Vec<u8>,
    images: Vec<(String, Vec<u8>)>,
    accessors: Vec<(Use, Accessor)>,
}

impl Arrays {
    /// Vertex attributes or their displacements, one f32 triple a vertex.
    pub(super) fn push_vectors(&mut self, vectors: &[[f32; 3]]) -> Index<Accessor> {
        let offset = self.vertices.len();
        self.vertices.extend(vectors.iter().flatten().flat_map(|component| component.to_le_bytes()));
        let bound = |pick: fn(f32, f32) -> f32, start: f32| {
            let corner = vectors.iter().fold([start; 3], |corner, vector| std::array::from_fn(|axis| pick(corner[axis], vector[axis])));
            Value::from(corner.to_vec())
        };
        let (min, max) = (bound(f32::min, f32::INFINITY), bound(f32::max, f32::NEG_INFINITY));
        self.push(Use::Vertices, offset, vectors.len(), ComponentType::F32, Type::Vec3, Some((min, max)))
    }

    /// Vertex indices of triangles, 16 bits wide when they fit.
    pub(super) fn push_triangles(&mut self, triangles: &[[u32; 3]], vertices: usize) -> Index<Accessor> {
        while !self.triangles.len().is_multiple_of(4) {
            self.triangles.push(0);
        }
        let offset = self.triangles.len();
        let indices = triangles.iter().flatten();
        // Index 65535 would restart a primitive in 16 bits; with 65535 vertices the last index is 65534.
        let kind = if u16::try_from(vertices).is_ok() {
            self.triangles.extend(indices.flat_map(|&index| (index as u16).to_le_bytes()));
            ComponentType::U16
        } else {
            self.triangles.extend(indices.flat_map(|&index| index.to_le_bytes()));
            ComponentType::U32
        };
        self.push(Use::Triangles, offset, 3 * triangles.len(), kind, Type::Scalar, None)
    }

    /// Texture coordinates, one pair a vertex.
    pub(super) fn push_places(&mut self, places: &[[f32; 2]]) -> Index<Accessor> {
        let offset = self.places.len();
        self.places.extend(places.iter().flatten().flat_map(|component| component.to_le_bytes()));
        self.push(Use::Places, offset, places.len(), ComponentType::F32, Type::Vec2, None)
    }

    /// A number a vertex.
    pub(super) fn push_scalars(&mut self, values: &[f32]) -> Index<Accessor> {
        let offset = self.scalars.len();
        self.scalars.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        self.push(Use::Scalars, offset, values.len(), ComponentType::F32, Type::Scalar, None)
    }

    /// A PNG picture.
    pub(super) fn push_image(&mut self, name: &str, png: Vec<u8>) -> Index<Image> {
        self.images.push((name.to_owned(), png));
        Index::new(self.images.len() as u32 - 1)
    }

    /// Times or weights of an animation.
    pub(super) fn push_keyframes(&mut self, values: &[f32]) -> Index<Accessor> {
        let offset = self.keyframes.len();
        self.keyframes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        let (min, max) = values.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(min, max), &value| (min.min(value), max.max(value)));
        let bounds = (Value::from(vec![min]), Value::from(vec![max]));
        self.push(Use::Keyframes, offset, values.len(), ComponentType::F32, Type::Scalar, Some(bounds))
    }

    fn push(
        &mut self,
        used: Use,
        offset: usize,
        count: usize,
        component: ComponentType,
        shape: Type,
        bounds: Option<(Value, Value)>,
    ) -> Index<Accessor> {
        let (min, max) = bounds.unzip();
        let accessor = Accessor {
            buffer_view: None,
            byte_offset: Some(USize64::from(offset)),
            count: USize64::from(count),
            component_type: Checked::Valid(GenericComponentType(component)),
            extensions: None,
            extras: None,
            type_: Checked::Valid(shape),
            min,
            max,
            name: None,
            normalized: false,
            sparse: None,
        };
        self.accessors.push((used, accessor));
        Index::new(self.accessors.len() as u32 - 1)
    }

    /// Puts accessors, views and the buffer into the document and returns the buffer's bytes.
    pub(super) fn finish(mut self, root: &mut Root) -> Vec<u8> {
        let mut bytes: Vec<u8> = Vec::with_capacity(self.vertices.len() + self.triangles.len() + self.keyframes.len() + 3);
        let mut push_view = |root: &mut Root, data: Vec<u8>, byte_stride: Option<Stride>, target: Option<Target>| {
            while !bytes.len().is_multiple_of(4) {
                bytes.push(0);
            }
            let view = root.push(View {
                buffer: Index::new(0),
                byte_length: USize64::from(data.len()),
                byte_offset: Some(USize64::from(bytes.len())),
                byte_stride,
                name: None,
                target: target.map(Checked::Valid),
                extensions: None,
                extras: None,
            });
            bytes.extend(data);
            view
        };
        let parts = [
            (Use::Vertices, self.vertices, Some(Stride(12)), Some(Target::ArrayBuffer)),
            (Use::Triangles, self.triangles, None, Some(Target::ElementArrayBuffer)),
            (Use::Keyframes, self.keyframes, None, None),
            (Use::Places, self.places, Some(Stride(8)), Some(Target::ArrayBuffer)),
            (Use::Scalars, self.scalars, Some(Stride(4)), Some(Target::ArrayBuffer)),
        ];
        for (used, data, byte_stride, target) in parts {
            if data.is_empty() {
                continue;
            }
            let view = push_view(root, data, byte_stride, target);
            for (_, accessor) in self.accessors.iter_mut().filter(|(of, _)| *of == used) {
                accessor.buffer_view = Some(view);
            }
        }
        for (name, png) in self.images {
            let buffer_view = Some(push_view(root, png, None, None));
            let mime_type = Some(MimeType("image/png".to_owned()));
            root.push(Image { buffer_view, mime_type, name: Some(name), uri: None, extensions: None, extras: None });
        }
        root.accessors = self.accessors.into_iter().map(|(_, accessor)| accessor).collect();
        root.push(Buffer { byte_length: USize64::from(bytes.len()), name: None, uri: None, extensions: None, extras: None });
        bytes
    }
}

/// The GLB container: header, JSON chunk padded with spaces, binary chunk padded with zeros (glTF 2.0 §4.4).
pub(super) fn container(json: Vec<u8>, binary: Vec<u8>) -> Result<Vec<u8>, ExportError> {
    let padded = |length: usize| length.next_multiple_of(4);
    let bytes = 12 + 8 + padded(json.len()) + 8 + padded(binary.len());
    let total = u32::try_from(bytes).map_err(|_| ExportError::TooLarge { bytes })?;
    let mut file = Vec::with_capacity(bytes);
    file.extend(b"glTF");
    file.extend(2_u32.to_le_bytes());
    file.extend(total.to_le_bytes());
    for (kind, padding, chunk) in [(b"JSON", b' ', json), (b"BIN\0", 0, binary)] {
        let length = padded(chunk.len());
        file.extend((length as u32).to_le_bytes());
        file.extend(kind);
        file.extend(&chunk);
        file.resize(file.len() + length - chunk.len(), padding);
    }
    Ok(file)
}

/// As glTF stores a vector.
pub(super) fn single(vector: DVec3) -> [f32; 3] {
    vector.as_vec3().to_array()
}
