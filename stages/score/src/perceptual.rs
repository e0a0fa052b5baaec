//! LPIPS of rendered images, with the network and the features of reference images kept for the life of the process.
//!
//! Every method and variant of a clip is compared with the same reference images, and half of the work of a comparison is
//! the reference's features. They are kept by the content of the image, so nothing has to know which clip is at hand.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use rogs_lpips::{Lpips, LpipsFeatures};
use rogs_worker::{StageError, StageResult};
use sha2::{Digest as _, Sha256};

/// Most memory that kept features take, bytes: the references of one clip (six cameras at seven times) take 0.9 GiB.
const MAX_KEPT_BYTES: usize = 1 << 30;

/// The networks and features of this process; one set of weights at a time.
static KEPT: Mutex<Option<Kept>> = Mutex::new(None);

struct Kept {
    weights: Stamp,
    network: Arc<Perceptual>,
}

/// Names, lengths and times of the weight files.
type Stamp = Vec<(PathBuf, u64, Option<SystemTime>)>;

/// LPIPS with remembered reference images.
pub(crate) struct Perceptual {
    network: Lpips,
    references: Mutex<References>,
}

impl Perceptual {
    /// The network of a weights file or folder. A second call with the same files gives the same network.
    pub(crate) fn open(path: &Path) -> StageResult<Arc<Self>> {
        let weights = stamp(path);
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kept) = kept.as_ref().filter(|kept| kept.weights == weights) {
            return Ok(Arc::clone(&kept.network));
        }
        let network = Lpips::open(path).map_err(|error| {
            StageError::bad_input(format!("the LPIPS weights `{}`: {error}", path.display())).with_hint(
                "give one file with torchvision's VGG16 and the five heads of the `lpips` package, or a folder with both: \
                 `rogs weights fetch vgg16`, `rogs weights fetch lpips-vgg`",
            )
        })?;
        let network = Arc::new(Self::new(network, MAX_KEPT_BYTES));
        *kept = Some(Kept {
            weights,
            network: Arc::clone(&network),
        });
        Ok(network)
    }

    fn new(network: Lpips, most: usize) -> Self {
        Self {
            network,
            references: Mutex::new(References {
                most,
                ..References::default()
            }),
        }
    }

    /// Distance of a render to an 8-bit reference image, or why there is none. `[H, W, 3]` each
    pub(crate) fn distance(&self, rgb: &[f32], reference: &[u8], height: usize, width: usize) -> Result<f64, String> {
        let features = self.reference(reference, height, width)?;
        let distance = self.network.distance_from(rgb, height, width, &features);
        distance.map_err(|error| error.to_string())
    }

    fn reference(&self, rgb: &[u8], height: usize, width: usize) -> Result<Arc<LpipsFeatures>, String> {
        let mut hash = Sha256::new();
        hash.update((height as u64).to_le_bytes());
        hash.update((width as u64).to_le_bytes());
        hash.update(rgb);
        let content: [u8; 32] = hash.finalize().into();
        let lock = || self.references.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = lock().find(&content) {
            return Ok(known);
        }
        let made = self.network.features_of_bytes(rgb, height, width);
        let made = Arc::new(made.map_err(|error| error.to_string())?);
        lock().keep(content, Arc::clone(&made));
        Ok(made)
    }
}

/// Features of reference images by content, the oldest given up first.
#[derive(Default)]
struct References {
    by_content: BTreeMap<[u8; 32], Arc<LpipsFeatures>>,
    oldest_first: VecDeque<[u8; 32]>,
    bytes: usize,
    most: usize,
    /// How often features were found.
    found: u64,
}

impl References {
    fn find(&mut self, content: &[u8; 32]) -> Option<Arc<LpipsFeatures>> {
        let known = self.by_content.get(content).map(Arc::clone);
        self.found += u64::from(known.is_some());
        known
    }

    fn keep(&mut self, content: [u8; 32], features: Arc<LpipsFeatures>) {
        if features.bytes() > self.most || self.by_content.contains_key(&content) {
            return;
        }
        while self.bytes + features.bytes() > self.most {
            let Some(oldest) = self.oldest_first.pop_front() else {
                break;
            };
            if let Some(given_up) = self.by_content.remove(&oldest) {
                self.bytes -= given_up.bytes();
            }
        }
        self.bytes += features.bytes();
        self.oldest_first.push_back(content);
        self.by_content.insert(content, features);
    }
}

/// What distinguishes one state of a weights file, or of the files of a folder, from another.
fn stamp(path: &Path) -> Stamp {
    let of = |path: PathBuf| {
        let metadata = std::fs::metadata(&path).ok();
        let length = metadata.as_ref().map_or(0, std::fs::Metadata::len);
        (path, length, metadata.and_then(|metadata| metadata.modified().ok()))
    };
    let mut stamp = vec![of(path.to_owned())];
    if let Ok(entries) = std::fs::read_dir(path) {
        stamp.extend(entries.flatten().map(|entry| of(entry.path())));
        stamp.sort();
    }
    stamp
}

#[cfg(test)]
mod tests {
    use rogs_lpips::LpipsWeights;

    use super::*;

    /// A network two channels wide with made-up weights.
    fn narrow() -> Lpips {
        let value = |seed: usize| ((seed * 37 % 17) as f32 - 7.5) / 10.0;
        let mut tensors = BTreeMap::new();
        let index = [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28];
        for (layer, place) in index.into_iter().enumerate() {
            let inputs = if layer == 0 { 3 } else { 2 };
            let weight: Vec<f32> = (0..2 * inputs * 9).map(|k| value(k + layer)).collect();
            tensors.insert(format!("features.{place}.weight"), (vec![2, inputs, 3, 3], weight));
            tensors.insert(format!("features.{place}.bias"), (vec![2], vec![0.1, 0.2]));
        }
        for layer in 0..5 {
            tensors.insert(
                format!("lin{layer}.model.1.weight"),
                (vec![1, 2, 1, 1], vec![0.5, 0.25]),
            );
        }
        let lookup = |name: &str| Ok(tensors.get(name).cloned());
        Lpips::new(LpipsWeights::from_lookup("narrow".into(), lookup).unwrap())
    }

    fn picture(seed: usize) -> Vec<u8> {
        (0..16 * 20 * 3).map(|k| (k * seed % 251) as u8).collect()
    }

    #[test]
    fn references_are_found_again_and_give_the_same_distance() {
        let own = Perceptual::new(narrow(), 1 << 20);
        let render: Vec<f32> = picture(7).iter().map(|&byte| f32::from(byte) / 255.0).collect();
        let first = own.distance(&render, &picture(11), 16, 20).unwrap();
        assert!(first > 0.0);
        assert_eq!(own.distance(&render, &picture(11), 16, 20), Ok(first));
        assert_eq!(own.references.lock().unwrap().found, 1);
        assert!(own.distance(&render, &picture(7), 16, 20).unwrap() < 1e-9);
    }

    #[test]
    fn the_oldest_reference_is_given_up_when_memory_is_full() {
        let one = narrow().features_of_bytes(&picture(3), 16, 20).unwrap().bytes();
        let own = Perceptual::new(narrow(), 2 * one);
        for seed in [3, 5, 7] {
            own.reference(&picture(seed), 16, 20).unwrap();
        }
        let mut kept = own.references.lock().unwrap();
        assert_eq!((kept.by_content.len(), kept.bytes, kept.found), (2, 2 * one, 0));
        drop(kept);
        own.reference(&picture(7), 16, 20).unwrap();
        own.reference(&picture(3), 16, 20).unwrap();
        kept = own.references.lock().unwrap();
        assert_eq!((kept.by_content.len(), kept.found), (2, 1));
    }

    #[test]
    fn images_that_are_too_small_say_so() {
        let own = Perceptual::new(narrow(), 0);
        let why = own.distance(&[0.5; 300], &[9; 300], 10, 10).unwrap_err();
        assert!(why.contains("16x16"), "{why}");
    }
}
