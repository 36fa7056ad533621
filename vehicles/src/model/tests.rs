#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::*;
use base64::Engine;
use std::path::PathBuf;

/// A square of two triangles in glTF's axes, 2 wide along x and 4 long along z; `change` is made to
/// the document.
fn write(name: &str, change: impl FnOnce(String) -> String) -> PathBuf {
    let floats = [[0.0f32, 0.5, 0.0], [2.0, 0.5, 0.0], [2.0, 0.5, 4.0], [0.0, 0.5, 4.0]];
    let mut bytes: Vec<u8> = floats.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    // Seen from above (y up) counter-clockwise.
    bytes.extend([0u16, 2, 1, 0, 3, 2].iter().flat_map(|v| v.to_le_bytes()));
    let data = base64::engine::general_purpose::STANDARD.encode(&bytes);
    let text = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
        "nodes":[{{"mesh":0,"translation":[0,0,1]}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"material":0}}]}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[1,0.2140411,0,1]}}}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0.5,0],"max":[2,0.5,4]}},
        {{"bufferView":1,"componentType":5123,"count":6,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":12}}],
        "buffers":[{{"byteLength":60,"uri":"data:application/octet-stream;base64,{data}"}}]}}"#
    );
    let path = std::env::temp_dir().join(format!("terravision-model-{}-{name}.gltf", std::process::id()));
    std::fs::write(&path, change(text)).unwrap();
    path
}

fn read(name: &str, change: impl FnOnce(String) -> String) -> Result<Model, String> {
    let path = write(name, change);
    let model = Model::read(&path).map_err(|error| error.to_string());
    std::fs::remove_file(path).unwrap();
    model
}

#[test]
fn a_model_is_ahead_along_z_and_up_along_y() {
    let model = read("good", |text| text).unwrap();
    let mesh = &model.levels[0];
    assert_eq!(mesh.triangles.len(), 2);
    assert!(mesh.vertices.iter().all(|vertex| vertex.normal.distance(Vec3::Z) < 1e-6), "up");
    // Along z of glTF from 1 to 5, along x to the left from 0 to 2.
    assert_eq!((model.middle, model.length_m), (Vec3::new(3.0, 1.0, 0.5), 4.0));
    assert!((model.radius_m - 5f32.sqrt()).abs() < 1e-6);
    let [r, g, b] = model.materials[0].rgb;
    assert!((r - 1.0).abs() < 1e-6 && (g - 0.5).abs() < 1e-3 && b == 0.0);
}

#[test]
fn what_is_mirrored_keeps_its_front() {
    let model = read("mirror", |text| text.replace(r#""translation":[0,0,1]"#, r#""scale":[-1,1,1]"#)).unwrap();
    let mesh = &model.levels[0];
    let flat = |triangle: &Triangle| {
        coarse::flat_normal(triangle.vertices.map(|v| mesh.vertices[v as usize].position)).unwrap()
    };
    assert!(mesh.triangles.iter().all(|triangle| flat(triangle).z > 0.9));
}

#[test]
fn a_model_that_cannot_be_used_is_told_in_a_sentence() {
    let refused = |name: &str, from: &str, to: &str| read(name, |text| text.replace(from, to)).unwrap_err();
    let beyond = refused("beyond", r#""count":4"#, r#""count":5"#);
    assert!(beyond.contains("accessor 0 goes beyond its bytes"), "{beyond}");
    let outside = refused("outside", r#""byteLength":12}]"#, r#""byteLength":99}]"#);
    assert!(outside.contains("which are not there"), "{outside}");
    let many = refused("many", r#""count":6"#, r#""count":3000003"#);
    assert!(many.contains("more than 1000000 triangles"), "{many}");
    let file = refused("file", "data:application/octet-stream;base64,", "nothing-here.bin?");
    assert!(file.contains("cannot be read") && file.contains("nothing-here.bin"), "{file}");
    let far = refused("far", "data:application/octet-stream;base64,", "https://example.org/");
    assert!(far.contains("not beside it"), "{far}");
    let circle = refused("circle", r#""mesh":0,"#, r#""mesh":0,"children":[0],"#);
    assert!(circle.contains("circle"), "{circle}");
    let empty = refused("empty", r#""nodes":[0]"#, r#""nodes":[]"#);
    assert!(empty.contains("no triangles") || empty.contains("not a model"), "{empty}");
    let extension = refused("extension", r#""scene":0"#, r#""extensionsRequired":["KHR_x"],"scene":0"#);
    assert!(extension.contains("KHR_x"), "{extension}");
    let text = read("text", |_| "{".into()).unwrap_err();
    assert!(text.contains("expected glTF 2.0"), "{text}");
    let missing = Model::read(Path::new("/nothing/here.gltf")).unwrap_err().to_string();
    assert!(missing.contains("/nothing/here.gltf"), "{missing}");
}

#[test]
fn coarse_levels_have_fewer_triangles_in_the_same_place() {
    // A wavy sheet of 100 by 100 cells.
    let side = 101u32;
    let mut mesh = Mesh::default();
    for k in 0..side * side {
        let [x, y] = [k % side, k / side].map(|v| v as f32);
        let position = Vec3::new(x, y, (0.3 * x).sin());
        mesh.vertices.push(Vertex { position, normal: Vec3::Z, uv: [0.0; 2] });
    }
    for k in 0..100 * 100 {
        let first = k / 100 * side + k % 100;
        for vertices in [[0, 1, side + 1], [0, side + 1, side]] {
            mesh.triangles.push(Triangle { vertices: vertices.map(|v| first + v), material: 0 });
        }
    }
    let materials = vec![Material { rgb: [1.0; 3], texture: None, is_double_sided: false }];
    let model = Model::new(read::Raw { mesh, materials, textures: vec![] }).unwrap();
    let counts: Vec<usize> = model.levels.iter().map(|level| level.triangles.len()).collect();
    assert!(counts.len() == 3 && counts[1] < 6000 && counts[2] < 400, "{counts:?}");
    for level in &model.levels {
        assert!(level.vertices.iter().all(|vertex| vertex.position.distance(model.middle) <= model.radius_m));
        assert!(level.vertices.iter().all(|vertex| vertex.normal.z > 0.0));
        assert!(level.triangles.iter().all(|triangle| (triangle.material as usize) < model.materials.len()));
    }
}

#[test]
fn textures_are_read_between_texels_and_from_smaller_ones_far_away() {
    let rgb = vec![[0, 0, 0], [200, 0, 0], [0, 100, 0], [200, 100, 255]];
    let texture = Texture::new([2, 2], rgb).unwrap();
    assert_eq!(texture.color([0.25, 0.25], 1.0), [0.0; 3]);
    let between = texture.color([0.5, 0.25], 1.0);
    assert!((between[0] - 100.0 / 255.0).abs() < 1e-6);
    assert_eq!(texture.color([0.9, 0.1], 8.0), texture.mean());
    assert!(Texture::new([2, 2], vec![[0; 3]]).is_none());
    assert!(Texture::decode(b"not a picture").is_err());
}
