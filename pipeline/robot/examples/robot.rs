//! Link poses of a robot as JSON, as `rogs fk` prints them, and a picture of it: `robot URDF --joints CSV [--picture PNG]`.
//!
//! The picture shows the first state from ahead, above and to the side, shaded by depth. What the files say and nothing
//! uses goes to standard error.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program for people")]

use std::error::Error;
use std::path::Path;

use glam::{DMat3, DVec3};
use rogs_geometry::{Base, Camera, Pinhole, Pose};
use rogs_robot::fk_json::FkTable;
use rogs_robot::{JointState, MeshScene, RenderOptions, RobotModel};
use rogs_schemas::Intrinsics;
use rogs_schemas::records::robot::{NO_LINK, RobotSpec};

const SIDE: u32 = 480;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [urdf, _, joints, more @ ..] = arguments.as_slice() else {
        return Err("usage: robot URDF --joints CSV [--picture PNG]".into());
    };
    let model = RobotModel::load(Path::new(urdf)).map_err(|error| error.chain())?;
    for note in &model.notes {
        eprintln!("note: {note}");
    }
    let text = std::fs::read_to_string(joints)?;
    let mut lines = text
        .lines()
        .map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let header: Vec<String> = lines
        .next()
        .unwrap_or_default()
        .into_iter()
        .filter(|name| !name.is_empty())
        .collect();
    let rows: Vec<Vec<String>> = lines
        .map(|row| if header.is_empty() { Vec::new() } else { row })
        .collect();
    let first = rows.first().cloned().unwrap_or_default();
    let table = FkTable::new(&model, &header)?;
    let poses = rows.iter().enumerate().map(|(row, fields)| table.row(row, fields));
    let poses = poses.collect::<Result<Vec<_>, _>>()?;
    println!("{}", serde_json::to_string(&poses)?);
    if let [_, picture] = more {
        let values = header
            .iter()
            .zip(&first)
            .map(|(name, value)| Ok((name.as_str(), value.parse()?)));
        let values = values.collect::<Result<Vec<(&str, f64)>, Box<dyn Error>>>()?;
        let state = model.joint_state(values).map_err(|error| error.chain())?;
        if let Err(error) = draw(&model, &state, Path::new(picture)) {
            eprintln!("no picture: {error}");
        }
    }
    Ok(())
}

fn draw(model: &RobotModel, state: &JointState, picture: &Path) -> Result<(), Box<dyn Error>> {
    let spec = RobotSpec {
        exclude_links: Vec::new(),
        collision_links: Vec::new(),
        ..RobotSpec::default()
    };
    let scene = MeshScene::of_robot(model, &spec).map_err(|error| error.chain())?;
    for note in &scene.notes {
        eprintln!("note: {note}");
    }
    let links = model.fk(state);
    let centre = links.iter().map(|pose| pose.translation).sum::<DVec3>() / links.len() as f64;
    let reach = links
        .iter()
        .map(|pose| (pose.translation - centre).length())
        .fold(0.1, f64::max);
    let away = 3.2 * reach;
    let eye = centre + DVec3::new(0.8, -0.5, 0.35).normalize() * away;
    let forward = (centre - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let base_from_camera: Pose<Base, Camera> = Pose::new(DMat3::from_cols(right, forward.cross(right), forward), eye);
    let lens = Pinhole {
        intrinsics: Intrinsics {
            fx: f64::from(SIDE),
            fy: f64::from(SIDE),
            cx: f64::from(SIDE) / 2.0,
            cy: f64::from(SIDE) / 2.0,
        },
        width: SIDE,
        height: SIDE,
    };
    let camera_from_link: Vec<_> = links.iter().map(|&pose| base_from_camera.inverse() * pose).collect();
    let image = scene.render(&lens, &camera_from_link, &RenderOptions::default())?;
    let shade = |pixel: usize| match image.link[pixel] {
        NO_LINK => image::Rgb([255, 255, 255]),
        link => {
            let nearness = 1.0 - ((f64::from(image.depth_m[pixel]) - away + reach) / (2.0 * reach)).clamp(0.0, 0.9);
            let tint = [
                0.6 + 0.4 * f64::from(link % 3) / 2.0,
                0.6 + 0.4 * f64::from(link % 5) / 4.0,
                0.9,
            ];
            image::Rgb(tint.map(|tint| (255.0 * nearness * tint) as u8))
        }
    };
    image::RgbImage::from_fn(SIDE, SIDE, |x, y| shade((y * SIDE + x) as usize)).save(picture)?;
    Ok(())
}
