//! Members of the kinds of fault that real files brought (`docs/lab/field.md`): what usual programs write is read, what has
//! another unit is told by name, what is no data is no data.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::Path;

use serde_json::{Value, json};

use crate::cases::{Cases, Failure, Nothing, Said, Warning, fixed, number};

/// The camera that `ext1` is.
fn camera(episode: &mut Value) -> &mut Value {
    let cameras = episode["cameras"].as_array_mut().unwrap();
    cameras.iter_mut().find(|camera| camera["id"] == "ext1").unwrap()
}

fn move_camera(episode: &mut Value, factor: f64) {
    for row in fixed(episode).as_array_mut().unwrap().iter_mut().take(3) {
        row[3] = json!(number(&row[3]) * factor);
    }
}

#[test]
fn numbers_of_another_unit_are_told_by_name() {
    let mut cases = Cases::new();
    cases.edited(
        "metres-1000",
        Failure("has a translation of", "these millimetres"),
        |episode| {
            move_camera(episode, 1000.0);
        },
    );
    cases.edited(
        "metres-100",
        Failure("has a translation of", "centimetres?"),
        |episode| {
            move_camera(episode, 100.0);
        },
    );
    cases.edited(
        "metres-001",
        Warning("m from the robot's base: was its pose in metres divided"),
        |episode| {
            move_camera(episode, 0.001);
        },
    );
    cases.edited("metres-0", Warning("was its pose never filled in"), |episode| {
        move_camera(episode, 0.0)
    });
    cases.edited("angles", Failure("has the angles", "were these degrees?"), |episode| {
        *fixed(episode) = json!([0.4, 0.0, 0.5, 180.0, 0.0, 90.0]);
    });
    cases.edited("lens-half", Warning("belong to images of another size"), |episode| {
        for (_, value) in camera(episode)["intrinsics"].as_object_mut().unwrap() {
            *value = json!(number(value) / 2.0);
        }
    });
    cases.edited(
        "lens-share",
        Warning("were they divided by the image's size"),
        |episode| {
            let lens = &mut camera(episode)["intrinsics"];
            for (name, side) in [("fx", 56.0), ("cx", 56.0), ("fy", 42.0), ("cy", 42.0)] {
                lens[name] = json!(number(&lens[name]) / side);
            }
        },
    );
    cases.edited(
        "range",
        Failure("its `range_m` begins at 100", "millimetres"),
        |episode| {
            camera(episode)["depth"]["range_m"] = json!([100, 5000]);
        },
    );
    let column = |column: usize, change: fn(usize, f64) -> f64| {
        move |rows: &mut Vec<Vec<String>>| {
            for (frame, row) in rows.iter_mut().skip(1).enumerate() {
                row[column] = change(frame, row[column].parse().unwrap()).to_string();
            }
        }
    };
    let metres = Warning("is it the gap of the fingers in metres? `gripper_range = [0.08, 0]`");
    cases.states("gap", metres, column(8, |frame, _| 0.08 - 0.004 * frame as f64));
    cases.states(
        "percent",
        Failure("the gripper is", "gripper_range"),
        column(8, |_, value| 100.0 * value),
    );
    let frames = Failure("the times step by 1,", "numbers of frames");
    cases.states("frames", frames, column(0, |frame, _| frame as f64));
    cases.edited(
        "period",
        Failure("the times step by", "the seconds of a frame"),
        |episode| {
            episode["fps"] = json!(1.0 / 15.0);
        },
    );
    cases.check();
}

/// Makes a copy of the good episode with another text of the table of states.
fn table(cases: &mut Cases, name: &str, said: Said, change: impl FnOnce(String) -> Vec<u8>) {
    let path = cases.add(name, said).join("joints.csv");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(path, change(text)).unwrap();
}

#[test]
fn tables_and_descriptions_as_programs_write_them() {
    let mut cases = Cases::new();
    let plain = |change: fn(String) -> String| move |text: String| change(text).into_bytes();
    table(&mut cases, "semicolons", Nothing, plain(|text| text.replace(',', ";")));
    table(&mut cases, "tabs", Nothing, plain(|text| text.replace(',', "\t")));
    table(
        &mut cases,
        "decimal",
        Nothing,
        plain(|text| text.replace(',', ";").replace('.', ",")),
    );
    table(
        &mut cases,
        "quotes",
        Nothing,
        plain(|text| {
            let quoted = |line: &str| format!("\"{}\"\n", line.replace(',', "\",\""));
            text.lines().map(quoted).collect()
        }),
    );
    table(
        &mut cases,
        "mark",
        Nothing,
        plain(|text| format!("\u{feff}{}", text.replace('\n', "\r\n"))),
    );
    table(
        &mut cases,
        "comment",
        Nothing,
        plain(|text| format!("# written by a logger\n{text}\n\n")),
    );
    table(
        &mut cases,
        "spreadsheet",
        Nothing,
        plain(|text| format!("sep=,\n{text}")),
    );
    let capitals = Failure("there is no column `panda_joint1`, did you mean `Panda_joint1`?", "");
    table(
        &mut cases,
        "capitals",
        capitals,
        plain(|text| text.replace("panda", "Panda")),
    );
    let utf16 = Failure("joints.csv`: it is UTF-16 text", "save it as UTF-8");
    table(&mut cases, "utf16", utf16, |text| {
        let mark = [0xff, 0xfe].into_iter();
        mark.chain(text.encode_utf16().flat_map(u16::to_le_bytes)).collect()
    });
    let latin = Failure("joints.csv`: it is no UTF-8 text", "save it as UTF-8");
    table(&mut cases, "latin", latin, |text| {
        [b"zeit\xe4,".as_slice(), text.as_bytes()].concat()
    });
    let description = |cases: &mut Cases, name: &str, said: Said, change: fn(&str) -> String| {
        let path = cases.add(name, said).join("episode.json");
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(path, change(&text)).unwrap();
    };
    // These cannot be listed by the name that they have inside: they are called by their folders.
    description(&mut cases, "json-mark", Nothing, |text| format!("\u{feff}{text}"));
    type Damage = fn(&str) -> String;
    let damages: [(&str, &str, Damage); 7] = [
        ("json-cut", "it ends in the middle", |text| text[..200].to_owned()),
        (
            "json-empty",
            "episode.json`: not an episode description: it is empty",
            |_| String::new(),
        ),
        ("json-comment", "JSON has no comments", |text| {
            format!("// by hand\n{text}")
        }),
        ("json-comma", "a comma or a value too much", |text| {
            format!("{},}}", text.trim_end().trim_end_matches('}'))
        }),
        ("json-text", "`frame_count`, line 1", |text| {
            text.replace("\"frame_count\":17", "\"frame_count\":\"17\"")
        }),
        ("json-field", "unknown field `distortion`", |text| {
            text.replacen("\"width\"", "\"distortion\":[0.1],\"width\"", 1)
        }),
        ("json-list", "it is a list, expected an object", |_| "[]".to_owned()),
    ];
    for (name, words, change) in damages {
        description(&mut cases, name, Failure(words, "docs/episode-format.md"), change);
    }
    cases.check();
}

fn rename_frames(folder: &Path, name: impl Fn(usize) -> String) {
    for frame in (0..17).rev() {
        std::fs::rename(
            folder.join(format!("ext1/{frame:06}.png")),
            folder.join("ext1").join(name(frame)),
        )
        .unwrap();
    }
}

/// Another shape in front of the same numbers.
fn reshape_depth(folder: &Path, shape: &[usize]) {
    let path = folder.join("depth/ext1.npy");
    let values = rogs_arrays::NpyFile::open(&path).unwrap().all().unwrap();
    let values: Vec<f32> = values.into_iter().map(|value| value as f32).collect();
    std::fs::write(path, rogs_arrays::npy_bytes(shape, &values)).unwrap();
}

#[test]
fn frames_and_depth_as_programs_write_them_and_what_is_no_data() {
    let mut cases = Cases::new();
    rename_frames(&cases.add("from-one", Nothing), |frame| format!("{:06}.png", frame + 1));
    rename_frames(&cases.add("prefix", Nothing), |frame| format!("frame_{frame:04}.png"));
    rename_frames(&cases.add("capitals", Nothing), |frame| format!("{frame}.PNG"));
    let jpeg = Failure(
        "it has 0 PNG files, the episode 17 frames",
        "`000000.jpg` and 16 more images",
    );
    rename_frames(&cases.add("jpeg", jpeg), |frame| format!("{frame:06}.jpg"));
    let copies = cases
        .add("copies", Failure("it has 18 PNG files", "`000000 (1).png`"))
        .join("ext1");
    std::fs::copy(copies.join("000000.png"), copies.join("000000 (1).png")).unwrap();
    let gap = Failure("`000016.png` is missing", "behind `000015.png` comes `000017.png`");
    let gap = cases.add("gap", gap).join("ext1");
    std::fs::rename(gap.join("000016.png"), gap.join("000017.png")).unwrap();

    let pointer = cases
        .add("lfs", Failure("a pointer of Git LFS", ""))
        .join("ext1/000008.png");
    std::fs::write(
        pointer,
        "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n",
    )
    .unwrap();
    let annex = cases
        .add("annex", Failure("it is a link to `../.git/annex/x`", "git annex get"))
        .join("ext1");
    std::fs::remove_file(annex.join("000008.png")).unwrap();
    std::os::unix::fs::symlink("../.git/annex/x", annex.join("000008.png")).unwrap();

    reshape_depth(&cases.add("depth-axis", Nothing), &[17, 1, 42, 56]);
    reshape_depth(&cases.add("depth-last", Nothing), &[17, 42, 56, 1]);
    let turned = Failure("the shape is [17, 56, 42], expected [17, 42, 56]", "numpy.transpose");
    reshape_depth(&cases.add("depth-turned", turned), &[17, 56, 42]);

    let strays = cases.add("strays", Nothing);
    for folder in ["", "ext1", "wrist", "depth"] {
        for name in [
            ".DS_Store",
            "Thumbs.db",
            "desktop.ini",
            "._000000.png",
            "000000.png~",
            "000017.png.part",
            "000017.png.tmp",
            ".000003.png.swp",
            "#000000.png#",
            "000017.png.crdownload",
            "000000.sync-conflict-20260131-1.png",
            "._episode.json",
            "~$joints.csv",
            "a.lock",
        ] {
            std::fs::write(strays.join(folder).join(name), "nobody's").unwrap();
        }
        for name in [
            "lost+found",
            "@eaDir",
            ".ipynb_checkpoints",
            "__MACOSX",
            ".git",
            "$RECYCLE.BIN",
            "#recycle",
        ] {
            let folder = strays.join(folder).join(name);
            std::fs::create_dir(&folder).unwrap();
            std::fs::write(folder.join("000000.png"), "nobody's").unwrap();
        }
    }
    cases.check();
    // They change no hash either: nothing is made again.
    let episodes = cases.workspace.path("data/episodes");
    for name in ["lost+found", "@eaDir", "__pycache__"] {
        std::fs::create_dir(episodes.join(name)).unwrap();
        std::fs::create_dir(episodes.join("strays").join(format!("{name}.bak"))).unwrap();
    }
    std::fs::write(episodes.join("strays/ext1/000018.png.part"), "more").unwrap();
    let (_, summary) = cases
        .workspace
        .rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!(summary["units"]["made"], json!(0), "{summary:#}");
}
