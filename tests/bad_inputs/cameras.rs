//! Poses and intrinsics of cameras.

use serde_json::json;

use crate::cases::{Cases, Failure, Warning, fixed, number};

#[test]
fn poses_and_intrinsics() {
    let mut cases = Cases::new();
    cases.edited(
        "scale",
        Failure("`base_from_camera` of camera `ext1` is not rigid", ""),
        |episode| {
            let matrix = fixed(episode);
            for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
                matrix[row][column] = (2.0 * number(&matrix[row][column])).into();
            }
        },
    );
    cases.edited(
        "shear",
        Failure("`base_from_camera` of camera `ext1` is not rigid", ""),
        |episode| {
            let matrix = fixed(episode);
            matrix[0][1] = (0.3 + number(&matrix[0][1])).into();
        },
    );
    cases.edited("mirror", Failure("reflection", ""), |episode| {
        let matrix = fixed(episode);
        for row in 0..3 {
            matrix[row][0] = (-number(&matrix[row][0])).into();
        }
    });
    cases.edited(
        "transposed",
        Failure("`base_from_camera` of camera `ext1` is not rigid", ""),
        |episode| {
            let matrix = fixed(episode).clone();
            for (row, column) in (0..4).flat_map(|row| (0..4).map(move |column| (row, column))) {
                fixed(episode)[row][column] = matrix[column][row].clone();
            }
        },
    );
    cases.edited("millimetres", Failure(" m", "were these millimetres?"), |episode| {
        let matrix = fixed(episode);
        for row in 0..3 {
            matrix[row][3] = (1000.0 * number(&matrix[row][3])).into();
        }
    });
    cases.edited("centimetres", Failure(" m", "centimetres?"), |episode| {
        let matrix = fixed(episode);
        for row in 0..3 {
            matrix[row][3] = (100.0 * number(&matrix[row][3])).into();
        }
    });
    cases.edited("second", Warning("the wrist camera must come first"), |episode| {
        episode["cameras"].as_array_mut().unwrap().swap(0, 1);
    });
    cases.edited("misspelt", Failure("x`; did you mean `", ""), |episode| {
        let link = &mut episode["cameras"][0]["mount"]["hand_eye"]["link"];
        *link = format!("{}x", link.as_str().unwrap()).into();
    });
    cases.edited(
        "key",
        Failure("unknown field `mout`", "did you mean `mount`?"),
        |episode| {
            let camera = episode["cameras"][0].as_object_mut().unwrap();
            let mount = camera.remove("mount").unwrap();
            camera.insert("mout".into(), mount);
        },
    );
    cases.edited(
        "zeros",
        Failure("all zeros: it was never filled in", "calibration"),
        |episode| {
            *fixed(episode) = json!([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]);
        },
    );
    // World-to-camera instead of camera-to-world is rigid too; that the camera sees no robot gives it away.
    cases.edited(
        "inverse",
        Warning("camera `ext1` never sees the robot: is its pose camera-to-base"),
        |episode| {
            let matrix = fixed(episode).clone();
            let inverse = fixed(episode);
            for row in 0..3 {
                for column in 0..3 {
                    inverse[row][column] = matrix[column][row].clone();
                }
                let translation: f64 = (0..3).map(|k| number(&matrix[k][row]) * number(&matrix[k][3])).sum();
                inverse[row][3] = (-translation).into();
            }
        },
    );
    cases.edited(
        "focal",
        Failure("the focal lengths of camera `wrist` are 0", ""),
        |episode| {
            episode["cameras"][0]["intrinsics"]["fx"] = 0.into();
        },
    );
    cases.edited(
        "centre",
        Failure("the principal point (640, ", "recorded image size"),
        |episode| {
            episode["cameras"][0]["intrinsics"]["cx"] = 640.into();
        },
    );
    cases.edited(
        "resized",
        Failure("images are 56x42, the episode says 112x84", "correct both"),
        |episode| {
            let camera = &mut episode["cameras"][0];
            (camera["width"], camera["height"]) = (112.into(), 84.into());
        },
    );
    cases.check();
}
