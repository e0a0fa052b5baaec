//! Pictures of the fields of a clip: the geometry that its cameras make together, and the robot's contour over renders.
//!
//! They follow figures 2 and 3 of the paper. Every figure has a row a method, whatever it was lifted with, and shows the
//! same views of each, so that rows compare.

use std::collections::BTreeSet;
use std::path::PathBuf;

use rogs_field::TimedField;
use rogs_geometry::{Base, Pose, Recon};
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, time_of_frame};
use rogs_schemas::records::field::Field;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, FrameIndex};

use super::comparison::{Comparison, middle};
use super::frames::target;
use super::merged::merged_row;
use super::outline::{Line, draw_contour};
use super::picture::Picture;
use super::studio::{Studio, View};
use crate::scenes::RobotMesh;

/// How far the viewpoint of the merged geometry is turned about the tool, degrees: far enough that surfaces which lie
/// behind one another from the cameras come apart.
const TURN_DEGREES: f64 = 20.0;
/// A field of the clip, and what it was lifted with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct FieldFile {
    /// Name of its rows.
    pub(crate) name: String,
    /// The file.
    pub(crate) path: PathBuf,
    /// Whether every camera was lifted by itself.
    pub(crate) camera_wise: bool,
    /// Whether the robot's mesh holds its Gaussians.
    pub(crate) anchored: bool,
    /// Whether kinematics told how it moves.
    pub(crate) conditioned: bool,
    /// Whether a world model made its observations.
    pub(crate) of_rollout: bool,
    /// Whether it is the field of the run, not of a variant.
    pub(crate) main: bool,
}

/// The figures of a clip while its fields are read, one at a time.
pub(crate) struct FieldFigures<'a> {
    clip: &'a Clip,
    studio: Studio<'a>,
    merged: Option<(View, Comparison)>,
    placed: Option<(Placed, Comparison)>,
    moved: Option<(Moved, Comparison)>,
}

/// A novel view with the contour of the robot.
struct Placed {
    camera: CameraIndex,
    frame: FrameIndex,
    views: [View; 2],
    recorded: bool,
}

/// A source view with the contours of two poses.
struct Moved {
    earlier: FrameIndex,
    frame: FrameIndex,
    views: [View; 2],
}

/// Whether the merged geometry of a field is shown.
fn merges(file: &FieldFile) -> bool {
    file.main || file.camera_wise
}

/// Whether it is shown where a field has the robot.
fn places(file: &FieldFile) -> bool {
    file.main || !file.anchored && !file.camera_wise
}

/// Whether it is shown how the robot of a field moves.
fn moves(file: &FieldFile) -> bool {
    file.main || !file.conditioned && !file.camera_wise
}

/// The fields that the figures show, in the order of their rows: the first of each way of lifting, then that of the run.
pub(crate) fn wanted(fields: &[FieldFile], of_rollout: bool) -> Vec<&FieldFile> {
    let own = || fields.iter().filter(|file| file.of_rollout == of_rollout);
    let first = |is: &dyn Fn(&&FieldFile) -> bool| own().find(|file| !file.main && is(file));
    let kinds: [&dyn Fn(&&FieldFile) -> bool; 3] = [
        &|file| file.camera_wise,
        &|file| !file.camera_wise && !file.anchored && file.conditioned,
        &|file| !file.camera_wise && file.anchored && !file.conditioned,
    ];
    let mut wanted: Vec<&FieldFile> = kinds.into_iter().filter_map(first).collect();
    wanted.extend(own().find(|file| file.main));
    wanted
}

impl<'a> FieldFigures<'a> {
    /// The figures of a clip without rows; what its cameras or its robot cannot show is left out.
    pub(crate) fn new(clip: &'a Clip, robot: &'a RobotMaps, mesh: Option<&RobotMesh>, wanted: &[&FieldFile]) -> Self {
        let studio = Studio::new(clip, robot, mesh);
        let mut figures = Self {
            clip,
            merged: None,
            placed: None,
            moved: None,
            studio,
        };
        // One method has nothing that its geometry could be compared with.
        if wanted.iter().any(|file| file.camera_wise) {
            figures.merged = figures.merged_view();
        }
        if figures.studio.has_mesh() {
            figures.placed = figures.placed_views();
            figures.moved = figures.moved_views();
        }
        figures
    }

    /// Those of the fields that some figure shows.
    pub(crate) fn read_by<'f>(&self, wanted: &[&'f FieldFile]) -> Vec<&'f FieldFile> {
        let shows = |file: &&&FieldFile| {
            self.merged.is_some() && merges(file)
                || self.placed.is_some() && places(file)
                || self.moved.is_some() && moves(file)
        };
        wanted.iter().filter(shows).copied().collect()
    }

    /// The figures in their order, with titles; those without rows are none.
    pub(crate) fn finish(self) -> Vec<(&'static str, Comparison)> {
        let figures = [
            ("Merged geometry of the cameras", self.merged.map(|(_, own)| own)),
            ("Where the robot is", self.placed.map(|(_, own)| own)),
            ("How the robot moves", self.moved.map(|(_, own)| own)),
        ];
        let shown = figures.into_iter().filter_map(|(title, own)| Some((title, own?)));
        shown.filter(|(_, own)| !own.rows.is_empty()).collect()
    }

    /// A field with the times that its rows show.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(crate) fn field(&self, file: &FieldFile) -> rogs_r4c::Result<Field> {
        let shown = [
            self.merged
                .as_ref()
                .filter(|_| merges(file))
                .map(|(view, _)| view.frame),
            self.placed.as_ref().filter(|_| places(file)).map(|(own, _)| own.frame),
            self.moved.as_ref().filter(|_| moves(file)).map(|(own, _)| own.frame),
        ];
        let shown: BTreeSet<FrameIndex> = shown.into_iter().flatten().collect();
        let stored = rogs_r4c::FieldFile::open(&file.path)?;
        let mut field = stored.base()?;
        for frame in shown {
            let time = time_of_frame(frame, self.clip.frame_count());
            if let Some(index) = stored.times().iter().position(|own| *own == time) {
                field.slices.push(stored.slice(index)?);
            }
        }
        Ok(field)
    }

    /// Adds the rows of a field.
    ///
    /// # Errors
    /// When the record contradicts itself.
    pub(crate) fn add(&mut self, file: &FieldFile, field: &Field) -> rogs_field::Result<()> {
        let timed = TimedField::new(field)?;
        let Ok(recon_from_base) = Pose::<Recon, Base>::from_rigid(&field.recon_from_base) else {
            return Ok(());
        };
        let at = |frame: FrameIndex| {
            let time = time_of_frame(frame, self.clip.frame_count());
            field.slice_at(time).map(|_| timed.gaussians(time)).transpose()
        };
        let studio = &self.studio;
        if let Some((view, own)) = self.merged.as_mut().filter(|_| merges(file))
            && let Some(gaussians) = at(view.frame)?
        {
            let row = merged_row(studio, view, field, &gaussians, &recon_from_base);
            own.rows.push((file.name.clone(), row));
        }
        if let Some((placed, own)) = self.placed.as_mut().filter(|_| places(file))
            && let Some(gaussians) = at(placed.frame)?
        {
            let whole = studio.render(&gaussians, placed.views[0].posed, &recon_from_base);
            let cells = placed.views.iter().map(|view| {
                let mut picture = view.of(whole.as_ref()?);
                draw_contour(&mut picture, &studio.silhouette(view, placed.frame)?, Line::CYAN);
                picture.jpeg(format!("{}, {}", file.name, view.name))
            });
            own.rows.push((file.name.clone(), cells.collect()));
        }
        if let Some((moved, own)) = self.moved.as_mut().filter(|_| moves(file))
            && let Some(gaussians) = at(moved.frame)?
        {
            let whole = studio.render(&gaussians, moved.views[0].posed, &recon_from_base);
            let cells = moved.views.iter().map(|view| {
                let mut picture = view.of(whole.as_ref()?);
                moved.draw(studio, view, &mut picture)?;
                picture.jpeg(format!("{}, {}", file.name, view.name))
            });
            own.rows.push((file.name.clone(), cells.collect()));
        }
        Ok(())
    }

    /// The viewpoint of the merged geometry: a fixed source camera, turned about the tool.
    fn merged_view(&self) -> Option<(View, Comparison)> {
        let clip = self.clip;
        let frame = middle(clip, true).or(middle(clip, false))?;
        let camera = fixed(clip, CameraRole::Source).or(clip.source_cameras().first().copied())?;
        let turned = self.studio.turned(camera, frame, TURN_DEGREES.to_radians())?;
        let view = self.studio.whole(turned, frame, "merged".to_owned());
        let mut columns = Vec::new();
        for source in clip.source_cameras() {
            columns.push(format!("{} alone", clip.cameras.get(source.at())?.id));
        }
        columns.extend(["merged", "merged, by camera", "crop", "crop, by camera"].map(str::to_owned));
        let note = format!(
            "Frame {frame}, seen from {} turned by {TURN_DEGREES}° about the tool. By camera: a hue for the Gaussians of each \
             camera, so that one surface drawn twice has two colours.",
            clip.cameras.get(camera.at())?.id
        );
        Some((
            view,
            Comparison {
                columns,
                rows: Vec::new(),
                note,
            },
        ))
    }

    /// The held-out camera beside a fixed one, or a fixed one turned, at a time that was not given.
    fn placed_views(&self) -> Option<(Placed, Comparison)> {
        let clip = self.clip;
        let frame = middle(clip, false).or(middle(clip, true))?;
        let (camera, posed, name) = if let Some(camera) = fixed(clip, CameraRole::Evaluation) {
            let posed = self.studio.posed(camera, frame)?;
            (
                camera,
                posed,
                format!("{} (held out)", clip.cameras.get(camera.at())?.id),
            )
        } else {
            let camera = fixed(clip, CameraRole::Source)?;
            let posed = self.studio.turned(camera, frame, TURN_DEGREES.to_radians())?;
            let name = format!("{} turned by {TURN_DEGREES}°", clip.cameras.get(camera.at())?.id);
            (camera, posed, name)
        };
        let recorded = clip.cameras.get(camera.at())?.role == CameraRole::Evaluation;
        let views = self.studio.whole_and_crop(posed, frame, &[frame], &name);
        let placed = Placed {
            camera,
            frame,
            views,
            recorded,
        };
        let star = if clip.source_frames.contains(&frame) {
            ""
        } else {
            ", which was not given"
        };
        let mut own = Comparison {
            columns: placed.views.iter().map(|view| view.name.clone()).collect(),
            rows: Vec::new(),
            note: format!("Cyan: contour of the robot's mesh at frame {frame}{star}."),
        };
        if placed.recorded
            && let Some(picture) = target(clip, placed.camera, frame)
        {
            let cells = placed.views.iter().map(|view| {
                let mut picture = view.of(&picture);
                draw_contour(&mut picture, &self.studio.silhouette(view, frame)?, Line::CYAN);
                picture.jpeg(format!("recorded, {}", view.name))
            });
            own.rows.push(("recorded".to_owned(), cells.collect()));
        }
        Some((placed, own))
    }

    /// A fixed source camera at the time that was not given where the tool is farthest from its first place.
    fn moved_views(&self) -> Option<(Moved, Comparison)> {
        let clip = self.clip;
        let earlier = *clip.source_frames.first()?;
        let start = self.studio.tool(earlier)?;
        let not_given = clip
            .query_frames
            .iter()
            .filter(|frame| !clip.source_frames.contains(frame));
        let far = |frame: &FrameIndex| self.studio.tool(*frame).map_or(0.0, |tool| tool.distance(start));
        let frame = *not_given.max_by(|a, b| far(a).total_cmp(&far(b)))?;
        let camera = fixed(clip, CameraRole::Source)?;
        let posed = self.studio.posed(camera, frame)?;
        let name = clip.cameras.get(camera.at())?.id.clone();
        let views = self.studio.whole_and_crop(posed, frame, &[earlier, frame], &name);
        let moved = Moved { earlier, frame, views };
        let mut own = Comparison {
            columns: moved.views.iter().map(|view| view.name.clone()).collect(),
            rows: Vec::new(),
            note: format!(
                "Green: contour of the robot's mesh at frame {frame}, which was not given. Dashed white: at frame {earlier}."
            ),
        };
        if let Some(picture) = target(clip, camera, frame) {
            let cells = moved.views.iter().map(|view| {
                let mut picture = view.of(&picture);
                moved.draw(&self.studio, view, &mut picture)?;
                picture.jpeg(format!("recorded, {}", view.name))
            });
            own.rows.push(("recorded".to_owned(), cells.collect()));
        }
        Some((moved, own))
    }
}

impl Moved {
    /// Draws both contours, the earlier one below.
    fn draw(&self, studio: &Studio<'_>, view: &View, picture: &mut Picture) -> Option<()> {
        draw_contour(picture, &studio.silhouette(view, self.earlier)?, Line::DASHED_WHITE);
        draw_contour(picture, &studio.silhouette(view, self.frame)?, Line::GREEN);
        Some(())
    }
}

/// The first camera of a role that stands still; of held-out ones, one beside such a camera or still itself.
fn fixed(clip: &Clip, role: CameraRole) -> Option<CameraIndex> {
    let still = |camera: CameraIndex| {
        let own = clip.cameras.get(camera.at());
        own.is_some_and(|own| matches!(own.mount, CameraMount::Fixed { .. }))
    };
    CameraIndex::first(clip.cameras.len()).find(|&camera| {
        let own = &clip.cameras[camera.at()];
        own.role == role && (still(camera) || own.partner.is_some_and(still))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(name: &str, camera_wise: bool, anchored: bool, conditioned: bool) -> FieldFile {
        FieldFile {
            name: name.to_owned(),
            path: name.into(),
            camera_wise,
            anchored,
            conditioned,
            of_rollout: false,
            main: name == "stage1",
        }
    }

    #[test]
    fn the_first_field_of_each_kind_is_shown_before_that_of_the_run() {
        let mut fields = vec![
            file("stage1", false, true, true),
            file("no-fk", false, true, false),
            file("no-mesh+no-fk", false, false, false),
            file("no-mesh", false, false, true),
            file("camera-wise", true, false, false),
            file("camera-wise-2", true, false, false),
        ];
        let names = |fields: &[FieldFile], rollout| -> Vec<String> {
            wanted(fields, rollout)
                .into_iter()
                .map(|file| file.name.clone())
                .collect()
        };
        assert_eq!(names(&fields, false), ["camera-wise", "no-mesh", "no-fk", "stage1"]);
        assert!(names(&fields, true).is_empty());
        fields.truncate(1);
        assert_eq!(names(&fields, false), ["stage1"]);
    }
}
