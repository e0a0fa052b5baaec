//! Mesh files of every kind; the first byte chooses the kind.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rogs_robot::{Mesh, MeshFile};
use rogs_schemas::records::robot::MeshAxes;

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, bytes)) = bytes.split_first() else {
        return;
    };
    let ending = ["stl", "obj", "dae", "gltf"][usize::from(*kind) % 4];
    if let Ok(MeshFile { mesh, .. }) = Mesh::parse(ending, bytes, MeshAxes::Viewers, &|_| Err("no other files".into()))
    {
        let count = mesh.positions.len();
        assert!(mesh.triangles.iter().flatten().all(|&corner| (corner as usize) < count));
        assert!(mesh.positions.iter().flatten().all(|value| value.is_finite()));
    }
});
