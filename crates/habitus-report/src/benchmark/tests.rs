use glam::DVec3;
use habitus::evaluation::distribution::Distribution;
use habitus::evaluation::sequence_accuracy::SequenceAccuracy;
use habitus::evaluation::sequence_errors::{FrameErrors, SequenceErrors, SequenceLabel};
use habitus::evaluation::sequence_metrics::{SequenceMetricsSettings, benchmark_metrics};

use super::{MeanBody, Variant, benchmark_figures, benchmark_page};

fn errors(style: &str, name: &str) -> SequenceErrors {
    let frame = |k: usize| FrameErrors {
        name: format!("frame_{k}"),
        posed_mean_mm: 5.0,
        mpjpe_mm: 6.0,
        landmarks_mm: vec![7.0, 30.0],
        outside_share_5mm: None,
        codes: Vec::new(),
        is_marked: false,
        seconds: None,
    };
    SequenceErrors {
        label: SequenceLabel {
            name: name.into(),
            subject: "one".into(),
            style: style.into(),
            motion: "walk".into(),
        },
        accuracy: SequenceAccuracy {
            posed_mean_mm: 5.0,
            rest_mean_mm: 6.0,
            rest_under_10mm: 1.0,
            mpjpe_mm: 6.0,
            stature_error_mm: 1.0,
            girth_mean_error_mm: 2.0,
            jitter_ratio: None,
        },
        posed: Distribution::default(),
        frames: (0..24).map(frame).collect(),
        rest_mm: vec![5.0, 6.0, 30.0, 7.0],
        rest_from_root_mm: vec![4.0, 5.0, 20.0, 6.0],
        rest_body: vec![DVec3::ZERO; 4],
        measurements: Vec::new(),
        jitter_mm: [1.0, 1.0],
    }
}

#[test]
fn every_figure_of_the_paper_is_there_and_the_page_holds_them_all() {
    let all = [errors("tight", "one_tight_walk"), errors("wide", "<one>_wide_walk")];
    let metrics = benchmark_metrics(&all, &SequenceMetricsSettings::default());
    let variant = |name| Variant { name, errors: &all, metrics: &metrics };
    let vertices = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    let body = MeanBody { vertices: &vertices, faces: &[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] };
    let figures = benchmark_figures(&[variant("default"), variant("paper2016")], body).expect("drawn");
    let names: Vec<&str> = figures.iter().map(|figure| figure.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "landmarks_tight_walk",
            "landmarks_by_style",
            "landmarks_by_sequence",
            "shape_truth",
            "shape_paper_protocol",
            "shape_map",
            "shape_by_variant",
            "drift"
        ]
    );
    let page = benchmark_page(&[variant("default"), variant("paper2016")], &figures);
    assert!(page.contains("2 sequences, 48 frames, none left out"));
    assert!(page.contains("&lt;one&gt;_wide_walk") && !page.contains("<one>"));
    assert!(!page.contains("<script") && !page.contains("NaN"));
    assert!(!page.contains("https://"), "nothing is loaded");
}

#[test]
fn one_variant_is_compared_with_no_other() {
    let all = [errors("tight", "one_tight_walk")];
    let metrics = benchmark_metrics(&all, &SequenceMetricsSettings::default());
    let vertices = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    let body = MeanBody { vertices: &vertices, faces: &[[0, 2, 1]] };
    let variant = Variant { name: "default", errors: &all, metrics: &metrics };
    let figures = benchmark_figures(&[variant], body).expect("drawn");
    assert!(figures.iter().all(|figure| figure.name != "shape_by_variant"));
    assert!(figures.iter().all(|figure| figure.name != "shape_paper_protocol"), "tight is the reference");
}
