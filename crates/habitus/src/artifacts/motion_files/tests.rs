use std::f64::consts::FRAC_PI_2;

use glam::{DQuat, DVec3};

use super::*;
use crate::artifacts::fixture::rigged_sequence;
use crate::artifacts::motion_bvh::bvh_text;
use crate::artifacts::npz::NpzWriter;

const BVH: &str = "\
HIERARCHY
ROOT hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT knee
  {
    OFFSET 0 -40 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -42 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.025
0 90 0 0 0 0 0 0 0
5 90 0 0 0 90 0 90 0
";

fn bvh(text: &str) -> Result<JointMotion, MotionFileError> {
    read_bvh(text, Path::new("walk.bvh"), "walk.bvh")
}

#[test]
fn bvh_turns_in_the_order_of_its_channels() {
    let motion = bvh(BVH).unwrap();
    let names: Vec<&str> = motion.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(names, ["hips", "knee", "knee_end"]);
    assert_eq!(motion.frame_rate.frames_per_second(), 40.0);
    assert_eq!(motion.positions[0], [[0.0, 90.0, 0.0], [0.0, 50.0, 0.0], [0.0, 8.0, 0.0]].map(DVec3::from));
    // The knee bends about x, then all turns about y: −z, where the shank points, becomes −x.
    let expected = [[5.0, 90.0, 0.0], [5.0, 50.0, 0.0], [5.0 - 42.0, 50.0, 0.0]].map(DVec3::from);
    for (found, expected) in motion.positions[1].iter().zip(expected) {
        assert!(found.distance(expected) < 1e-9, "{found} {expected}");
    }
}

#[test]
fn the_motion_that_we_write_is_the_motion_that_we_read() {
    let fit = rigged_sequence(7);
    let motion = bvh(&bvh_text(&fit, FrameRate::new(30.0).unwrap())).unwrap();
    for (frame, positions) in motion.positions.iter().enumerate() {
        let posed = fit.posed_skeleton(frame);
        for (joint, position) in motion.joints.iter().zip(positions) {
            let bone = fit.rig.skeleton.bones().iter().position(|bone| bone.name == joint.name);
            // Six decimals of centimetres and degrees.
            assert!(bone.is_none_or(|bone| position.distance(posed.joints[bone] * 100.0) < 1e-4));
        }
    }
}

#[test]
fn broken_bvh_ends_in_an_error_that_names_the_line() {
    let cases = [
        ("", "the file ends"),
        (&BVH[..60], "the file ends"),
        (&BVH.replace("OFFSET 0 -40 0", "OFFSET 0 nan 0"), "line 8: an offset must be a finite number"),
        (&BVH.replace("Frames: 2", "Frames: 999999999999"), "2 are there"),
        (&BVH.replace("CHANNELS 3", "CHANNELS 900000000"), "a joint has 0 to 6"),
        (&BVH.replace("Frame Time: 0.025", "Frame Time: 0"), "not possible"),
        (&BVH.replace("0 90 0 0 0 0 0 0 0\n", "0 90 0 0 0 0 0 0\n"), "the file ends"),
        (&BVH.replace("Yrotation\n  JOINT", "Wrotation\n  JOINT"), "is no channel"),
        (&BVH.replace("}\nMOTION", "}\n}\nMOTION"), "has no meaning here"),
        (&BVH[..BVH.len() - 37], "line"),
    ];
    for (text, expected) in cases {
        let message = bvh(text).unwrap_err().to_string();
        assert!(message.contains(expected) && message.contains("walk.bvh"), "{message} ({expected})");
    }
}

const ASF: &str = "\
:version 1.10
:units
  mass 1.0
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name thigh
    direction 0 -1 0
    length 4
    axis 0 0 20 XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
    id 2
    name shank
    direction 0 -1 0
    length 3
    axis 0 90 0 XYZ
    dof rx
  end
:hierarchy
  begin
    root thigh
    thigh shank
  end
";
const AMC: &str = "\
#!OML:ASF made up
:FULLY-SPECIFIED
:DEGREES
1
root 1 9 2 0 0 0
thigh 0 0 0
shank 0
2
root 1 9 2 0 0 90
thigh 0 0 0
shank 90
";

fn amc(skeleton: &str, motion: &str) -> Result<JointMotion, MotionFileError> {
    read_asf_amc(skeleton, Path::new("02.asf"), motion, Path::new("02_01.amc"), 120.0)
}

#[test]
fn asf_bones_turn_about_their_own_axes() {
    let motion = amc(ASF, AMC).unwrap();
    let names: Vec<&str> = motion.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(names, ["root", "thigh", "shank", "shank_end"]);
    let hip = DVec3::new(1.0, 9.0, 2.0);
    assert!(motion.positions[0][2].distance(hip - DVec3::Y * 4.0) < 1e-9);
    assert!(motion.positions[0][3].distance(hip - DVec3::Y * 7.0) < 1e-9);
    // A turn of the root about z brings −y to +x. The shank's own x axis lies along −z of its parent's rest, about
    // which a quarter turn takes its −y to −x, which the root brings to −y.
    let knee = hip + DVec3::X * 4.0;
    assert!(motion.positions[1][2].distance(knee) < 1e-9);
    let shank = DQuat::from_rotation_z(FRAC_PI_2)
        * DQuat::from_rotation_y(FRAC_PI_2)
        * DQuat::from_rotation_x(FRAC_PI_2)
        * DQuat::from_rotation_y(-FRAC_PI_2)
        * DVec3::NEG_Y;
    assert!(shank.distance(DVec3::NEG_Y) < 1e-9);
    assert!(motion.positions[1][3].distance(knee + shank * 3.0) < 1e-9);
}

#[test]
fn broken_asf_and_amc_end_in_errors_that_name_the_place() {
    let cases = [
        (ASF.replace("root thigh", "root hand"), AMC.to_string(), "'hand' is no bone"),
        (ASF.replace("root thigh\n", "shank thigh\n"), AMC.into(), "does not hang from the root"),
        (ASF.replace("thigh shank", "thigh thigh"), AMC.into(), "two parents"),
        (ASF[..300].into(), AMC.into(), "the file ends"),
        (ASF.replace("length 4", "length inf"), AMC.into(), "finite number"),
        (ASF.replace("20 XYZ", "20 XQZ"), AMC.into(), "no order of axes"),
        (ASF.into(), AMC.replace("shank 90", "tail 90"), "line 11: bone 'tail' is not in 02.asf"),
        (ASF.into(), AMC.replace("shank 90\n", "shank\n"), "the file ends"),
        (ASF.into(), ":DEGREES\n".into(), "no frame"),
        (":hierarchy\nbegin\nend\n".into(), AMC.into(), "no hierarchy"),
    ];
    for (skeleton, motion, expected) in cases {
        let message = amc(&skeleton, &motion).unwrap_err().to_string();
        assert!(message.contains(expected), "{message} ({expected})");
    }
}

fn amass(frames: usize, width: usize, edit: impl Fn(&mut Vec<f64>)) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.npz");
    let mut poses = vec![0.0; frames * width];
    edit(&mut poses);
    let mut file = NpzWriter::new();
    file.add("poses", &[frames, width], &poses);
    file.add("trans", &[frames, 3], &vec![1.0; frames * 3]);
    file.add("mocap_framerate", &[], &[120.0]);
    file.write(&path).unwrap();
    std::fs::read(&path).unwrap()
}

#[test]
fn amass_rotations_turn_what_hangs_below() {
    // The left knee bends by a quarter turn: its ankle goes backwards.
    let bytes = amass(2, 156, |poses| poses[156 + 4 * 3] = FRAC_PI_2);
    let motion = read_amass(bytes, Path::new("take.npz")).unwrap();
    assert_eq!(motion.frame_rate.frames_per_second(), 120.0);
    let place = |frame: usize, name: &str| {
        let joint = motion.joints.iter().position(|joint| joint.name == name).unwrap();
        motion.positions[frame][joint]
    };
    assert_eq!(place(0, "pelvis"), DVec3::ONE);
    assert!(place(0, "left_ankle").y < place(0, "left_knee").y - 0.4);
    let shank = place(1, "left_ankle") - place(1, "left_knee");
    assert!(shank.distance(DVec3::new(0.0, 0.02, -0.41)) < 1e-9, "{shank}");
    assert_eq!(place(0, "right_ankle"), place(1, "right_ankle"));
}

#[test]
fn broken_amass_files_end_in_errors() {
    let path = Path::new("take.npz");
    let narrow = read_amass(amass(2, 24, |_| ()), path).unwrap_err().to_string();
    assert!(narrow.contains("at least 66"), "{narrow}");
    let not_finite = read_amass(amass(2, 72, |poses| poses[3] = f64::NAN), path).unwrap_err().to_string();
    assert!(not_finite.contains("not a finite number"), "{not_finite}");
    let cut = amass(2, 72, |_| ());
    assert!(read_amass(cut[..cut.len() / 2].to_vec(), path).is_err());
    assert!(matches!(read_amass(amass(0, 72, |_| ()), path), Err(MotionFileError::NoFrames { .. })));
}

#[test]
fn a_file_without_its_skeleton_says_where_to_put_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("02_01.amc");
    std::fs::write(&path, AMC).unwrap();
    let message = read_joint_motion(&path).unwrap_err().to_string();
    assert!(message.contains("copy it there as 02.asf"), "{message}");
    std::fs::write(folder.path().join("02.asf"), ASF).unwrap();
    assert_eq!(read_joint_motion(&path).unwrap().positions.len(), 2);
    assert!(matches!(
        read_joint_motion(&folder.path().join("dance.fbx")),
        Err(MotionFileError::UnknownFormat { .. })
    ));
}
