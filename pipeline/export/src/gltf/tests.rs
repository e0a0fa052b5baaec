use super::*;
use crate::dataset::test_clip;
use crate::splats::tests::scene;

fn file(axes: Axes, times: &[f64]) -> Vec<u8> {
    let (clip, robot) = test_clip();
    let mut file = Gltf::new(axes, LengthUnit::Metre, &Pose::IDENTITY);
    for (k, time) in times.iter().enumerate() {
        let mut gaussians = scene(40, 2);
        gaussians.means.iter_mut().for_each(|value| *value += 0.1 * k as f32);
        file.push(*time, &gaussians).unwrap();
    }
    let mesh = LinkMesh {
        link: "hand".into(),
        positions: vec![[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]],
        triangles: vec![[0, 1, 2]],
    };
    file.rig(&clip, &robot, &[mesh]).unwrap();
    file.finish("a test").unwrap()
}

/// The crate `gltf` reads what we write: nodes, animations, accessors.
#[test]
fn another_reader_finds_gaussians_links_and_cameras() {
    let bytes = file(Axes::Base, &[0.0, 0.1, 0.2]);
    let read = gltf::Gltf::from_slice_without_validation(&bytes).unwrap();
    let blob = read.blob.as_deref().unwrap();
    let names: Vec<&str> = read.document.nodes().filter_map(|node| node.name()).collect();
    assert_eq!(
        names,
        [
            "world",
            "gaussians",
            "base",
            "base",
            "hand",
            "wrist",
            "ext1",
            "ext1_right"
        ]
    );
    let splats = read.document.meshes().next().unwrap();
    let primitive = splats.primitives().next().unwrap();
    let positions: Vec<[f32; 3]> = primitive.reader(|_| Some(blob)).read_positions().unwrap().collect();
    let scene = scene(40, 2);
    assert_eq!(positions.concat(), scene.means);
    let (_, morphed) = primitive
        .reader(|_| Some(blob))
        .read_morph_targets()
        .map(|(positions, _, _)| positions.unwrap().collect::<Vec<_>>())
        .enumerate()
        .last()
        .unwrap();
    assert!((morphed[3][1] - 0.2).abs() < 1e-6);
    let animation = read.document.animations().next().unwrap();
    let mut moved = 0;
    for channel in animation.channels() {
        let reader = channel.reader(|_| Some(blob));
        let times = reader.read_inputs().unwrap().count();
        assert_eq!(times, 3);
        match reader.read_outputs().unwrap() {
            gltf::animation::util::ReadOutputs::Translations(shifts) => {
                moved += 1;
                assert_eq!(shifts.count(), 3);
            }
            gltf::animation::util::ReadOutputs::Rotations(turns) => {
                let turns: Vec<[f32; 4]> = turns.into_f32().collect();
                let dot: f32 = turns[0].iter().zip(turns[1]).map(|(a, b)| a * b).sum();
                assert!(dot >= 0.0);
            }
            gltf::animation::util::ReadOutputs::MorphTargetWeights(weights) => {
                let weights: Vec<f32> = weights.into_f32().collect();
                assert_eq!(weights, [0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
            }
            gltf::animation::util::ReadOutputs::Scales(_) => panic!("nothing changes its size"),
        }
    }
    assert_eq!(moved, 5, "two links and three cameras");
    let camera = read.document.cameras().next().unwrap();
    let gltf::camera::Projection::Perspective(lens) = camera.projection() else {
        panic!("a perspective camera");
    };
    assert!((f64::from(lens.yfov()) - 2.0 * (2.0_f64 / 5.5).atan()).abs() < 1e-6);
}

#[test]
fn the_extension_has_every_attribute_once_and_no_more_than_its_degree() {
    let bytes = file(Axes::Recon, &[0.0]);
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let document: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let primitive = &document["meshes"][0]["primitives"][0];
    assert_eq!(primitive["extensions"][EXTENSION]["kernel"], "ellipse");
    let attributes = primitive["attributes"].as_object().unwrap();
    assert_eq!(attributes.len(), 2 + 3 + 9);
    assert!(attributes.contains_key("KHR_gaussian_splatting:SH_DEGREE_2_COEF_4"));
    assert!(primitive.get("targets").is_none(), "one time needs none");
    assert_eq!(document["nodes"][0]["rotation"], json!([1.0, 0.0, 0.0, 0.0]));
    assert_eq!(
        bytes.len(),
        u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize
    );
}

#[test]
fn what_does_not_fit_is_refused() {
    let new = || Gltf::new(Axes::Base, LengthUnit::Metre, &Pose::IDENTITY);
    assert!(new().finish("").is_err());
    assert!(new().push(0.0, &Gaussians::empty()).is_err());
    let mut twice = new();
    twice.push(0.0, &scene(2, 0)).unwrap();
    assert!(
        twice
            .push(0.0, &scene(2, 0))
            .unwrap_err()
            .to_string()
            .contains("ascend")
    );
    assert!(twice.push(1.0, &scene(3, 0)).is_err());
    let (clip, mut robot) = test_clip();
    robot.base_from_link.pop();
    assert!(twice.rig(&clip, &robot, &[]).is_err());
}
