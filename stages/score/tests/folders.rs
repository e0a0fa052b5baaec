//! Scores of image files and folders.

use image::{Rgb, RgbImage};
use rogs_score::folders::{FolderError, score_paths};
use rogs_score::metrics::{Pixels, RgbView, SsimVariant, psnr, ssim};

fn picture(seed: u32) -> RgbImage {
    RgbImage::from_fn(32, 24, |x, y| {
        Rgb([(x * 8 + seed) as u8, (y * 9) as u8, ((x * y + seed) % 256) as u8])
    })
}

#[test]
fn two_files_and_two_folders_give_the_scores_of_their_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own", "other"].map(|name| folder.path().join(name));
    for (folder, seed) in [(&own, 0), (&other, 5)] {
        std::fs::create_dir(folder).unwrap();
        for name in ["a.png", "b.png"] {
            picture(seed).save(folder.join(name)).unwrap();
        }
    }
    picture(0).save(own.join("c.png")).unwrap();
    std::fs::write(other.join("notes.txt"), "no image").unwrap();
    let variant = SsimVariant::Torchmetrics;
    let scores = score_paths(&own, &other, variant, None).unwrap();
    let (a, b) = (picture(0), picture(5));
    let view = |image: &'static RgbImage| RgbView::new(24, 32, Pixels::Bytes(image.as_raw())).unwrap();
    let (a, b) = (view(Box::leak(Box::new(a))), view(Box::leak(Box::new(b))));
    assert_eq!(
        scores.pairs.iter().map(|pair| pair.name.as_str()).collect::<Vec<_>>(),
        ["a.png", "b.png"]
    );
    assert_eq!(scores.psnr, Some(psnr(&a, &b).unwrap()));
    assert_eq!(scores.ssim, Some(ssim(&a, &b, variant).unwrap()));
    assert_eq!(
        (scores.only_in_prediction, scores.only_in_reference),
        (vec!["c.png".to_owned()], vec![])
    );
    assert_eq!((scores.lpips, scores.lpips_note.is_some()), (None, true));

    let distance = |_: &[u8], _: &[u8], height: usize, width: usize| Some((height * width) as f64);
    let one = score_paths(&own.join("a.png"), &other.join("a.png"), variant, Some(&distance)).unwrap();
    assert_eq!((one.psnr, one.lpips), (scores.psnr, Some(768.0)));
}

#[test]
fn what_cannot_be_scored_is_explained() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own", "other"].map(|name| folder.path().join(name));
    std::fs::create_dir_all(&own).unwrap();
    std::fs::create_dir_all(&other).unwrap();
    let variant = SsimVariant::default();
    assert!(matches!(
        score_paths(&own, &other, variant, None),
        Err(FolderError::NothingInCommon { .. })
    ));
    picture(0).save(own.join("a.png")).unwrap();
    assert!(matches!(
        score_paths(&own.join("a.png"), &other, variant, None),
        Err(FolderError::Mixed { .. })
    ));
    RgbImage::new(8, 8).save(other.join("a.png")).unwrap();
    let error = score_paths(&own, &other, variant, None).unwrap_err();
    assert!(
        matches!(&error, FolderError::Pair { name, .. } if name == "a.png"),
        "{error}"
    );
    std::fs::write(other.join("a.png"), b"nonsense").unwrap();
    assert!(matches!(
        score_paths(&own, &other, variant, None),
        Err(FolderError::Image { .. })
    ));
    let small = folder.path().join("small.png");
    RgbImage::new(8, 8).save(&small).unwrap();
    let scores = score_paths(&small, &small, variant, None).unwrap();
    assert_eq!((scores.psnr, scores.ssim), (Some(100.0), None));
}
