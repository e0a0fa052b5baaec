//! What is rendered: a field at any time, or a PLY file.

use std::path::Path;

use anyhow::Context as _;
use rogs_field::TimedField;
use rogs_geometry::{Base, Pose, PosedCamera, Recon};
use rogs_lift::FieldQuery;
use rogs_r4c::{read_record, read_refinement_of};
use rogs_schemas::CameraIndex;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::units::LengthUnit;
use rogs_splat::Gaussians;

use super::network::{BesideArgs, Network, insert};
use super::viewpoint::Scenery;

/// A field as it was read, with the network that answers other times where one is needed.
pub(crate) struct FieldFile {
    pub(crate) field: Field,
    pub(crate) refinement: Option<Refinement>,
    pub(crate) network: Option<Network>,
}

impl FieldFile {
    /// Reads a field and its correction; the network where one of the times is not stored.
    pub(crate) fn read(
        path: &Path,
        refinement: Option<&Path>,
        times: impl FnOnce(&Field) -> anyhow::Result<Vec<f64>>,
        beside: &BesideArgs,
    ) -> anyhow::Result<(Self, Vec<f64>)> {
        let (field, info) = read_record::<Field>(path)?;
        let times = times(&field)?;
        let outside = times.iter().find(|time| !(0.0..=1.0).contains(*time));
        if let Some(time) = outside {
            anyhow::bail!("time {time} is outside the clip, which spans 0 to 1");
        }
        let refinement = match refinement {
            Some(path) => Some(read_refinement_of(path, info.provenance.key())?),
            None => None,
        };
        let stored = times.iter().all(|time| field.slice_at(*time).is_some());
        let network = if stored {
            None
        } else {
            Some(Network::load(path, &field, &info, beside)?)
        };
        let file = Self {
            field,
            refinement,
            network,
        };
        Ok((file, times))
    }

    /// What [`Scene`] asks for times that are not stored.
    pub(crate) fn query(&self) -> anyhow::Result<Option<FieldQuery<'_>>> {
        self.network
            .as_ref()
            .map(|network| network.query(&self.field))
            .transpose()
    }
}

/// A scene over time.
pub(crate) enum Scene<'a> {
    Ply(Gaussians),
    Field {
        file: &'a FieldFile,
        query: Option<Box<FieldQuery<'a>>>,
        /// The field with one more slice than it stores, made where one is needed.
        shown: Option<Box<Field>>,
        scenery: Option<&'a Scenery>,
        recon_from_base: Pose<Recon, Base>,
    },
}

impl<'a> Scene<'a> {
    /// The scene of a field.
    pub(crate) fn of(file: &'a FieldFile, scenery: Option<&'a Scenery>) -> anyhow::Result<Self> {
        Ok(Self::Field {
            file,
            query: file.query()?.map(Box::new),
            shown: None,
            scenery,
            recon_from_base: Pose::from_rigid(&file.field.recon_from_base)?,
        })
    }

    /// Of the Gaussians' lengths.
    pub(crate) fn unit(&self) -> LengthUnit {
        match self {
            Self::Ply(_) => LengthUnit::Metre,
            Self::Field { .. } => LengthUnit::Internal,
        }
    }

    /// Where the robot's base stands; the world of a PLY file itself.
    pub(crate) fn recon_from_base(&self) -> Pose<Recon, Base> {
        match self {
            Self::Ply(_) => Pose::IDENTITY,
            Self::Field { recon_from_base, .. } => *recon_from_base,
        }
    }

    pub(crate) fn clip(&self) -> Option<&Clip> {
        match self {
            Self::Ply(_) => None,
            Self::Field { scenery, .. } => scenery.map(|scenery| &scenery.clip),
        }
    }

    /// A camera of the clip at a time.
    pub(crate) fn camera_at(&self, camera: CameraIndex, time: f64) -> anyhow::Result<PosedCamera<Recon>> {
        let Self::Field {
            scenery: Some(scenery), ..
        } = self
        else {
            anyhow::bail!("a PLY file has no cameras: give `lookat:...` or a .json file");
        };
        Ok(scenery.at(camera, time)?.in_frame(&self.recon_from_base()))
    }

    /// The Gaussians at a time, unit of [`Self::unit`], reconstruction frame.
    pub(crate) fn gaussians(&mut self, time: f64) -> anyhow::Result<Gaussians> {
        match self {
            Self::Ply(gaussians) => Ok(gaussians.clone()),
            Self::Field { .. } => self.timed(time, |timed| Ok(timed.gaussians(time)?)),
        }
    }

    /// What a field says with the slice of a time in it, stored or answered.
    pub(crate) fn timed<T>(
        &mut self,
        time: f64,
        ask: impl FnOnce(&TimedField<'_>) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let Self::Field { file, query, shown, .. } = self else {
            anyhow::bail!("a PLY file holds one time");
        };
        let corrected = |field: &Field| {
            let timed = TimedField::new(field)?;
            let timed = match &file.refinement {
                Some(refinement) => timed.with_refinement(refinement)?,
                None => timed,
            };
            ask(&timed)
        };
        if file.field.slice_at(time).is_some() {
            return corrected(&file.field);
        }
        let (network, query) = file
            .network
            .as_ref()
            .zip(query.as_ref())
            .context("no network was loaded")?;
        let slice = network.at(query, &file.field, time)?;
        let shown = shown.get_or_insert_with(|| {
            Box::new(Field {
                query_state: Vec::new(),
                ..file.field.clone()
            })
        });
        insert(shown, slice);
        let answer = corrected(shown);
        shown.slices.retain(|slice| slice.time != time);
        answer
    }
}

/// A PLY file as a scene.
pub(crate) fn read_ply(path: &Path) -> anyhow::Result<Scene<'static>> {
    let scene = rogs_field::ply::read_ply_file(path)?;
    Ok(Scene::Ply(scene.gaussians))
}
