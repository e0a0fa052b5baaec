//! HDF5 files as h5py writes them, in the oldest and in the newest form of the format (`hdf5/make.py`).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::{Path, PathBuf};

use rogs_arrays::{ANY, Hdf5File, Hdf5Value};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hdf5").join(name)
}

/// Both files: superblock 0 with symbol tables, superblock 3 with link messages and new chunk indices.
fn files() -> [Hdf5File; 2] {
    ["old.h5", "new.h5"].map(|name| Hdf5File::open(&path(name)).unwrap())
}

#[test]
fn numbers_of_every_type_are_read() {
    let ramp: Vec<f64> = (0..12).map(f64::from).collect();
    for file in files() {
        for name in [
            "f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "big_f8", "big_i2",
        ] {
            let dataset = file.need(&format!("numbers/{name}")).unwrap();
            dataset.expect_shape(&[ANY, 3]).unwrap();
            assert_eq!(dataset.read::<f64>().unwrap(), ramp, "{name}");
            assert_eq!(dataset.read_rows::<f64>(1..3).unwrap(), ramp[3..9], "{name}");
            assert_eq!(dataset.is_whole(), !name.contains('f'), "{name}");
        }
        let whole = file.need("numbers/wide").unwrap();
        assert_eq!(whole.read::<i64>().unwrap(), [i64::MAX, i64::MIN]);
        assert!(whole.read::<u16>().unwrap_err().to_string().contains("0 to 65535"));
        let real = file.need("numbers/f4").unwrap();
        assert!(real.read::<i64>().unwrap_err().to_string().contains("F32"));
        let truth = file.need("numbers/truth").unwrap().read::<u8>().unwrap();
        assert_eq!(truth, [0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1]);
        let single = file.need("numbers/single").unwrap();
        assert_eq!((single.shape().len(), single.read::<f32>().unwrap()), (0, vec![1.5]));
        assert!(
            single
                .read_rows::<f32>(0..1)
                .unwrap_err()
                .to_string()
                .contains("no rows")
        );
        let none = file.need("numbers/none").unwrap();
        assert_eq!((none.shape(), none.read::<f64>().unwrap().len()), (&[0, 5][..], 0));
    }
}

#[test]
fn packed_tables_are_read_whole_and_by_rows() {
    let table: Vec<i64> = (0..240).collect();
    for file in files() {
        for name in ["gzip", "lzf", "all", "lzf_shuffle", "grown", "plain"] {
            let dataset = file.need(&format!("packed/{name}")).unwrap();
            assert_eq!(dataset.read::<i64>().unwrap(), table, "{name}");
            assert_eq!(dataset.read_rows::<i64>(6..15).unwrap(), table[72..180], "{name}");
            assert_eq!(dataset.read_rows::<i64>(20..20).unwrap(), [0_i64; 0]);
            assert!(
                dataset
                    .read_rows::<i64>(19..21)
                    .unwrap_err()
                    .to_string()
                    .contains("no rows 19 to 21 in 20")
            );
        }
        // 4 GiB of a value that was never written: more than a file of some kilobytes can hold.
        let sparse = file.need("packed/sparse").unwrap();
        assert!(
            sparse
                .read::<f32>()
                .unwrap_err()
                .to_string()
                .contains("more than a file of this length")
        );
        assert_eq!(sparse.read_rows::<f32>(5..6).unwrap(), [0.0; 1024]);
    }
}

#[test]
fn texts_and_images_are_read() {
    for file in files() {
        assert_eq!(file.need("texts/fixed").unwrap().texts().unwrap(), ["one", "three"]);
        assert_eq!(file.need("texts/free").unwrap().texts().unwrap(), ["eins", "", "zwei"]);
        let images = file.need("texts/images").unwrap().byte_strings().unwrap();
        assert_eq!(images, [b"\xff\xd8 jpeg".to_vec(), b"x".to_vec()]);
        assert!(file.need("texts/free").unwrap().read::<f64>().is_err());
        assert!(
            file.need("numbers/f4")
                .unwrap()
                .texts()
                .unwrap_err()
                .to_string()
                .contains("no texts")
        );
    }
}

#[test]
fn attributes_have_their_types() {
    for file in files() {
        let attributes = file.attributes("").unwrap();
        let numbers = Hdf5Value::Numbers(vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        let expected = [
            ("text", Hdf5Value::Text("grün".into())),
            ("bytes", Hdf5Value::Text("fixed".into())),
            ("true", Hdf5Value::Truth(true)),
            ("whole", Hdf5Value::Integer(-7)),
            ("large", Hdf5Value::Real(2.0_f64.powi(64))),
            ("real", Hdf5Value::Real(0.25)),
            ("numbers", numbers),
            ("texts", Hdf5Value::Texts(vec!["a".into(), "bc".into()])),
            ("nothing", Hdf5Value::Empty),
            ("record", Hdf5Value::Other),
        ];
        assert_eq!(attributes.len(), expected.len());
        for (name, value) in expected {
            assert_eq!(attributes[name], value, "{name}");
        }
        assert_eq!(
            file.attributes("numbers/f4").unwrap()["write_complete"].truth(),
            Some(true)
        );
        assert!(file.attributes("numbers").unwrap().is_empty());
    }
}

#[test]
fn groups_are_listed_and_links_followed_inside_the_file_only() {
    for file in files() {
        let many = file.groups("many").unwrap();
        assert_eq!((many.len(), many[0].as_str(), many[11].as_str()), (12, "0:11", "9:20"));
        assert!(file.has_group("many/7:18").unwrap() && !file.has_group("many/7:19").unwrap());
        assert_eq!(file.datasets("texts").unwrap(), ["fixed", "free", "images"]);
        assert_eq!(file.need("soft").unwrap().read::<f64>().unwrap()[11], 11.0);
        for name in ["away", "loop", "numbers/f9", "numbers/f8/x"] {
            assert!(
                file.dataset(name).map(|found| found.is_none()).unwrap_or(true),
                "{name}"
            );
        }
        let error = file.need("texts/images/deep").err().unwrap().to_string();
        assert!(
            error.contains("has no `texts/images/deep`; `/texts` holds fixed, free, images"),
            "{error}"
        );
        let error = file.need("gone").err().unwrap().to_string();
        assert!(error.contains("`/` holds"), "{error}");
    }
}

/// Reads everything that a file holds.
fn read_all(file: &Hdf5File) -> rogs_arrays::Result<()> {
    file.attributes("")?;
    for group in file.groups("")? {
        file.attributes(&group)?;
        file.groups(&group)?;
        for name in file.datasets(&group)? {
            let dataset = file.need(&format!("{group}/{name}"))?;
            dataset.attributes()?;
            let rows = dataset.shape().first().copied().unwrap_or(0).min(3);
            match name.as_str() {
                "fixed" | "free" => drop(dataset.texts()?),
                "images" => drop(dataset.byte_strings()?),
                "sparse" => drop(dataset.read_rows::<f32>(0..rows)?),
                _ => drop(dataset.read::<f64>()?),
            }
        }
    }
    Ok(())
}

#[test]
fn cut_files_are_refused_and_damaged_ones_never_panic() {
    for name in ["old.h5", "new.h5"] {
        let whole = std::fs::read(path(name)).unwrap();
        let open = |bytes: Vec<u8>| Hdf5File::from_bytes(Path::new(name), bytes);
        read_all(&open(whole.clone()).unwrap()).unwrap();
        for length in (0..whole.len()).step_by(97) {
            let error = open(whole[..length].to_vec()).err().unwrap().to_string();
            assert!(
                error.contains("cut off") || error.contains("no HDF5 file"),
                "{length}: {error}"
            );
        }
        let mut refused = 0;
        for at in (0..whole.len()).step_by(61) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0xff;
            refused += usize::from(open(bytes).and_then(|file| read_all(&file)).is_err());
        }
        assert!(refused > 50, "{name}: only {refused} damaged files were refused");
    }
    assert!(
        Hdf5File::open(&path("make.py"))
            .err()
            .unwrap()
            .to_string()
            .contains("no HDF5 file")
    );
    assert!(
        Hdf5File::open(&path("gone.h5"))
            .err()
            .unwrap()
            .to_string()
            .contains("gone.h5")
    );
}
