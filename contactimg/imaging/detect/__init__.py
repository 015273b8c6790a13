"""Candidates: where light stands out of its surroundings, and a first estimate of each contact.

Read in this order: `candidates` (regions at half of their own plateau, split into disks), `components`
(labelling by runs of pixels), `inscribed_disks`, `peaks` (a matched filter for small contacts),
`bars_and_scratches` (also hairs; dust is found by `contactimg.imaging.evidence.reference_dust`), `rim_blur`
(a first guess of the blur), `hand_edits`.
"""
