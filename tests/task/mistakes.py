"""Mistakes in task files, each as a change of a valid file and what is to be said of it.

A line is `old -> new :: words | more words @ place`: the first `old` is replaced, or with `+` in place of
`->` another line comes after it. The message must name the line on which what is put in ends, or of `place`,
and contain all the words. Names in capitals stand for longer texts, `\\n` for the end of a line.
"""

from __future__ import annotations

IN_A_TASK = r"""
version = 1 + nam = 1 :: nam: there is no such key | 'name'
modules = 6 + module = 1 :: arm.module: there is no such key (did you mean 'modules'?); allowed:
cycle = "20 ms" + velocty = 1 :: limits.velocty: there is no such key (did you mean 'velocity'?); allowed:
name = "geodesic" + joint_weigth = 1
    :: controller.joint_weigth: there is no such key (did you mean 'joint_weight'?); allowed:
posture = "straight" + joint = 1 :: start.joint: there is no such key (did you mean 'joints'?); allowed:
margin = "5 mm" + margn = 1 :: scene.margn: there is no such key (did you mean 'margin'?); allowed:
name = "bowed" + methd = 1 :: keyframe 2, methd: there is no such key (did you mean 'method'?); allowed:
[output] -> [output]\nformts = 1 :: output.formts: there is no such key (did you mean 'formats'?); allowed:
radius = 0.1 + radus = 1
    :: scene.obstacles.ball.radus: there is no such key (did you mean 'radius'?); allowed: type, center
LINE -> curve = { type = "line", a = [0, 0, 0], c = 1, b = [0.3, 0, 0] }
    :: keyframe 1, curve.c: there is no such key; allowed: a, b
hold = 0.1 -> tip = { positon = [0, 0, 0] } :: tip.positon | 'position'
modules = 6 + feed = { strok = 1 } :: feed.strok | 'stroke'
"90 deg/s" -> { turn = 1 } :: velocity.turn | 'turning'
"20 ms" -> "20 mm" :: limits.cycle: is '20 mm', of the kind length |  s, ms, min
"20 ms" -> "20 sec" :: '20 sec' | 'sec' is not a known unit
"20 ms" -> "20" :: '20', without a unit |  s, ms, min
"20 ms" -> "soon" :: is 'soon'; allowed: a number in SI units
"20 ms" -> true :: limits.cycle: is True; allowed: a number
"90 deg/s" -> "90 deg" :: limits.velocity: is '90 deg', of the kind angle
acceleration = 10 -> acceleration = "10 rad/s" :: kind rate of turning
"90 deg/s" -> "9 cm/s" :: '9 cm/s', of the kind speed
["25 mm", 0.025] -> [\n  0.1,\n  "25 deg",§\n] :: arm.link_length 2: is '25 deg'
name = "bow" -> name = 3 :: name: is 3; allowed: text
trim = true -> trim = "yes" :: keyframe 2, trim: is 'yes'; allowed: true or false
TEMPLATE -> :: arm: needs one of the keys 'urdf', 'template' @ [arm]
LIMITS -> :: limits: is 3; allowed: a table @ limits = 3
version = 1 -> version = 2 :: version: is 2; allowed: 1
version = 1 -> version = true :: version: is True; allowed: 1
"keyframes" -> "keyframe" :: kind: is 'keyframe' | did you mean 'keyframes' | 'follow_leader'
[output] -> [leader]§\nspeed = 1\n[output] :: leader: goes with kind = 'follow_leader' | 'keyframes'
version = 1 + continuity = "jerk" :: 'jerk' | 'velocity', 'acceleration'
["npz", "csv"] -> ["npz", "pdf"] :: output.formats | 'pdf' | npz, csv, json, png, html
["npz", "csv"] -> "npz" :: output.formats: is 'npz' | a list of
"RyRz" -> "RyRx" :: arm.template | 'RyRx' | did you mean 'RyRz'
"RyRz" -> 3 :: arm.template: is 3; allowed: text
modules = 6\n -> :: arm: the key 'modules' is missing @ [arm]
modules = 6 -> modules = 0 :: arm.modules: is 0; allowed: a whole number, 1 to 1000
modules = 6 -> modules = 6.5 :: arm.modules: is 6.5
modules = 6 -> modules = true :: arm.modules: is True
["25 mm", 0.025] -> [0.1] :: arm.link_lengths: is [0.1]; allowed: a list of 2
["25 mm", 0.025] -> [0.1, -1] :: arm.link_lengths | -1
["-170 deg", 3.0] -> ["1 deg", -1] :: arm.joint_limits | lower < upper
modules = 6 + placement = { position = [0, 0] } :: arm.placement.position: is [0, 0] | 3
modules = 6 + feed = { speed = 1 } :: arm.feed: the key 'stroke' is missing
modules = 6 + feed = { stroke = 0 } :: arm.feed.stroke: is 0; allowed: more than 0
modules = 6 + feed = { stroke = 1, length = -1 } :: arm.feed | -1
TEMPLATE -> urdf = "none.urdf" :: arm.urdf | none.urdf: no such file
TEMPLATE -> urdf = "broken.urdf" :: arm.urdf | broken.urdf: line 3
TEMPLATE -> urdf = "." :: arm.urdf
TEMPLATE -> urdf = "~nobody-here/a.urdf" :: arm.urdf | '~nobody-here/a.urdf'
TEMPLATE -> urdf = "a\u0000b" :: arm.urdf
TEMPLATE -> feed = { stroke = 1 }§\nurdf = "arm.urdf"\n :: arm.feed: does not go with 'urdf'
modules = 6 + tip = "tip" :: arm.tip: does not go with 'template'
TEMPLATE -> urdf = "arm.urdf"\ntip = "tipp" :: arm.tip | 'tipp' | did you mean 'tip'
TEMPLATE -> urdf = "arm.urdf"\ntip = 3 :: arm.tip: is 3; allowed: text
TEMPLATE -> urdf = "arm.urdf"\nsplit = 5 :: arm.split: is 5; allowed:
TEMPLATE -> urdf = "arm.urdf"\nsplit = "2" :: arm.split
TEMPLATE -> urdf = "arm.urdf"\nlocked = { m01_j1_y = "1 s" } :: arm.locked.m01_j1_y | '1 s'
TEMPLATE -> urdf = "arm.urdf"\ncouplings = { m01_j1_y = 3 } :: arm.couplings.m01_j1_y | 3
TEMPLATE -> urdf = "arm.urdf"\nlocked = { m01_j1_x = 0 } :: arm.locked | 'm01_j1_x' | 'm01_j1_y'
TEMPLATE -> urdf = "arm.urdf"\npackage_dirs = "x" :: arm.package_dirs | a list of folders
"20 ms" -> 0 :: limits.cycle: is 0; allowed: more than 0
"20 ms" -> "-20 ms" :: limits.cycle: is '-20 ms'; allowed: more than 0
"20 ms" -> "2 min" :: limits.cycle: is '2 min'; allowed: 60 s at most
"20 ms" -> inf :: limits.cycle: is inf, which is not finite
"20 ms" -> "1e999 s" :: limits.cycle: is '1e999 s', which is not finite
"90 deg/s" -> nan :: limits.velocity: is nan
"90 deg/s" -> "-90 deg/s" :: limits.velocity: is '-90 deg/s'; allowed: a positive number
"90 deg/s" -> [1, 2, 3] :: limits.velocity: is [1, 2, 3]; allowed: a list of 12
"90 deg/s" -> { turning = 0 } :: limits.velocity.turning: is 0; allowed: more than 0
cycle = "20 ms" -> step = 0 :: limits.step: is 0; allowed: a positive number
cycle = "20 ms" -> position_margin = -1 :: limits.position_margin: is -1
cycle = "20 ms" -> position_margin = 4 :: limits.position_margin: is 4; allowed: at most 2.98
LIMITED -> feed = { stroke = 1 }\n[limits]\nvelocity = "90 deg/s"
    :: limits.velocity | turns and slides | turning = ..., sliding = ...
"geodesic" -> "pq" :: controller.name: is 'pq' | 'selection', 'projection'
name = "geodesic"\njoint_weight = 0.2 -> name = "joint"\njoint_weight = 0.2
    :: controller.joint_weight | 'geodesic' | 'joint'
joint_weight = 0.2 -> joint_weight = "0.2" :: controller.joint_weight: is '0.2'; allowed: a number
joint_weight = 0.2 -> joint_weight = -1 :: controller.joint_weight: is -1
joint_weight = 0.2 -> joint_weight = nan :: controller.joint_weight: is nan
"straight"\n\n[scene] -> "bent"§\n\n[scene] :: start.posture: is 'bent'; allowed: 'straight', 'neutral'
posture = "straight" -> joints = [0, 0, 0] :: start.joints: has 3 values; needed: 12, one for each joint [rad]
posture = "straight" -> joints = [0, 40, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
    :: start.joints: start[1] is 40.0 | rad, the limits of joint 'm01_j2_z'; is it in degrees?
posture = "straight" -> joints = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, nan] :: start.joint 12: is nan
posture = "straight" -> joints = ['1 m', 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, ]
    :: start.joint 1: is '1 m', of the kind length
posture = "straight" -> posture = "straight"§\njoints = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, ]
    :: start.posture: does not go with 'joints'
SCENE -> [scene]\nfile = "none.toml" :: scene.file | none.toml: no such file
SCENE -> [scene]\nfile = "broken.toml" :: scene.file | broken.toml | line 1
SCENE -> [scene]\nfile = "scene.toml"\nmargin = "5 mm"§\n :: scene.margin: there is no such key; allowed: file
"sphere" -> "spher" :: scene.obstacles.ball.type: is 'spher' (did you mean 'sphere'?); allowed: 'sphere'
type = "sphere"\n -> :: scene.obstacles.ball: the key 'type' is missing; allowed: @ [scene.obstacles.ball]
radius = 0.1\n -> :: scene.obstacles.ball: the key 'radius' is missing @ [scene.obstacles.ball]
radius = 0.1 -> radius = 0 :: scene.obstacles.ball.radius: is 0; allowed: a length
radius = 0.1 -> radius = "1 lb" :: scene.obstacles.ball.radius: is '1 lb' | 'lb'
[0.0, 0.0, "-50 cm"] -> [0, 0] :: scene.obstacles.ball.center: is [0, 0]
SCENE -> [scene.obstacles]\nball = 3 :: scene.obstacles.ball: is 3; allowed: a table
SCENE -> [scene]\nobstacles = [] :: scene.obstacles: is []; allowed: a table
SCENE -> [scene.obstacles.rock]\ntype = "mesh"\npath = "rock.stl"§\n :: scene.obstacles.rock.path: | rock.stl
"5 mm" -> "-5 mm" :: scene.margin: is '-5 mm'
margin = "5 mm" -> version = 7 :: scene.version: is 7
margin = "5 mm" -> self_collision = 1 :: scene.self_collision: is 1; allowed: true or false
[0.0, 0.0, "-50 cm"] -> [0.0, 0.0, "-5 cm"]
    :: scene.obstacles.ball | base of the arm | (0, 0, 0) | move it @ [scene.obstacles.ball]
SCENE -> [scene]§\nfile = "scene.toml"\n :: scene.obstacles.rock | base of the arm
BOWED -> :: keyframes: there is only one; allowed: two or more @ [[keyframes]]
KEYFRAMES -> [keyframes]§\nname = "a"\n :: keyframes: is {'name': 'a'} | [[keyframes]]
KEYFRAMES -> :: keyframes: is [1, 2]; allowed: a list of tables @ keyframes = [1, 2]
BOW -> :: keyframe 2: needs one of the keys 'curve', 'joints' @ SECOND
BOW -> joints = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0] :: keyframe 2, placement: goes with 'curve' @ placement
BOWED -> [[keyframes]]\ntime = 1\njoints = [0, 0]\n
    :: keyframe 2, joints: has 2 values; needed: 12, one for each joint [rad] @ joints
BOWED -> [[keyframes]]\ntime = 1\njoints = ["9 m", 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]\n
    :: keyframe 2, joint 1: is '9 m', of the kind length @ joints
BOWED -> [[keyframes]]\ntime = 1\njoints = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, "175 deg", 0]\n
    :: keyframe 2, joints: is 3.054 rad for joint 11 'm06_j1_y', whose limits are -2.967 and 3 rad @ joints
BOWED -> [[keyframes]]\ntime = 1\njoints = [0, -40, 0, 0, 0, 0, 0, 0, 0, 0, 30, 0]\n
    :: keyframe 2, joints: is -40 rad for joint 2 'm01_j2_z' | is it in degrees? | "-40 deg" @ joints
BOW -> curve = { type = "helix", radius = 100, pitch = 0, turns = 0.6 }
    :: keyframe 2, curve: is 377 m long; allowed: 30 m at most, 100 times the arm; if it is in millimetres
BOW -> curve = { path = 3 } :: keyframe 2, curve: is 3 | name of a file
BOW -> curve = { path = "way.csv", scle = 2 }
    :: keyframe 2, curve.scle: there is no such key (did you mean 'scale'?)
hold = 0.1 -> speed = 0 :: keyframe 2, speed: is 0; allowed: a share of the velocity limits, in (0, 1]
hold = 0.1 -> speed = "9 cm/s" :: keyframe 2, speed: is '9 cm/s'; allowed: a share of the velocity limits
version = 1 + repeat = 0 :: repeat: is 0; allowed: a whole number of at least 1
time = "1 s" + duration = 1 :: keyframe 2:  | time and duration | one of them @ SECOND
"1 s" -> "-1 s" :: keyframe 2, time: is '-1 s'; allowed: a finite number >= 0
hold = 0.1 -> hold = -0.1 :: keyframe 2, hold: is -0.1
placement = "align" -> placement = "algn" :: keyframe 2, placement: is 'algn' | did you mean 'align'
hold = 0.1 -> method = "best" :: keyframe 2, method: is 'best' | 'auto', 'sequential'
BOW -> curve = "helx" :: keyframe 2, curve: is 'helx' | did you mean 'helix' | .csv
BOW -> curve = 3 :: keyframe 2, curve: is 3; allowed: a name, a file, or a table
BOW -> curve = "none.csv" :: keyframe 2, curve | none.csv: | o such file
BOW -> curve = "broken.csv" :: keyframe 2, curve | broken.csv: line 2 | 'two'
BOW -> curve = "curve.xyz" :: keyframe 2, curve | '.xyz' | .json, .csv, .txt
BOW -> curve = { radius = 1 } :: keyframe 2, curve | 'type' | helix
BOW -> curve = { type = "helx" } :: keyframe 2, curve | 'helx' | 'helix'
BOW -> curve = { type = "helix", pitch = 0, turns = 1 } :: keyframe 2, curve | 'radius'
BOW -> curve = { type = "helix", radius = "0 cm", pitch = 0, turns = 0.6 }
    :: keyframe 2, curve.radius: is '0 cm'
BOW -> curve = { type = "helix", radius = "10 s", pitch = 0, turns = 0.6 }
    :: keyframe 2, curve.radius: is '10 s', of the kind time
LINE -> curve = { type = "line", a = [0, 0, 0], b = [0, 0, 0] } :: keyframe 1, curve
hold = 0.1 -> region = [0, 3] :: keyframe 2, region: is [0, 3]; allowed: 1 or more
hold = 0.1 -> region = [3, 1] :: keyframe 2, region: is [3, 1] | the last not before the first
hold = 0.1 -> region = 3 :: keyframe 2, region: is 3; allowed: two whole numbers
hold = 0.1 -> region = [1, 7] :: keyframe 2, region: is [1, 7]; the arm has control points 1 to 6
hold = 0.1 -> tip = { weight = 3 } :: keyframe 2, tip: the key 'position' is missing
hold = 0.1 -> tip = { rotation = [0, 0, 0] } :: keyframe 2, tip: the key 'position' is missing
hold = 0.1 -> tip = { position = [0, 0, 0], direction_only = true } :: keyframe 2, tip.direction_only: is True
hold = 0.1 -> tip = { position = [0, 0, 0], point = 0 } :: keyframe 2, tip.point: is 0; allowed: 1 or more
hold = 0.1 -> tip = { position = [0, 0, 0], point = 7 } :: keyframe 2, tip.point: is 7; allowed: 1 to 6
hold = 0.1 -> tip = { position = [0, 0, 0], point = "module_7" }
    :: keyframe 2, tip.point | 'module_7' | module_06
hold = 0.1 -> tip = { position = [0, 0, 0], weight = 0 } :: keyframe 2, tip.weight: is 0
hold = 0.1 -> tip = { position = [0, 0, "1 s"] } :: keyframe 2, tip.position 3: is '1 s'
"""
"""Found when the file is read."""

SEARCHED = r"""
version = 1 + repeat = 1000000 :: repeat: is 1000000; allowed: 9523 at most
[output] -> [[keyframes]]§\ntime = 0.5\ncurve = "line"\ntrim = true\n[output]
    :: keyframe 3: it is at 0.5 s, but keyframe 2 is left at 1.1 s | increase
time = "1 s"\n -> :: keyframe 2 'bowed': it has neither a time nor a duration @ SECOND
name = "straight"\n -> name = "straight"\ntime = 1\n
    :: keyframe 1 'straight': it is at 1 s; the first keyframe is at 0 @ [[keyframes]]
name = "straight"\n -> name = "straight"\nduration = 1\n
    :: keyframe 1 'straight': its duration is 1 s, the time to return | set repeat to 2 @ [[keyframes]]
"1 s" -> "1 ms" :: keyframe 2 'bowed' | same control cycle @ SECOND
"1 s" -> "600000 min" :: keyframe 2 'bowed': it ends at 3.6e+07 s | at most @ SECOND
0.3, 0, 0 -> 0.2, 0, 0 :: keyframe 1 'straight': module 5 | curve ends | lengthen @ [[keyframes]]
["-170 deg", 3.0] -> [-0.1, 0.1] :: keyframe 2 'bowed': module 1 | joint limits | gentler curve @ SECOND
hold = 0.1 -> tip = { position = [1, 1, 1], priority = true }
    :: keyframe 2 'bowed': its tip task with priority is missed by | weight @ SECOND
"""
"""Found when the arm is to take the postures."""

IN_A_LEADER = r"""
LED -> :: leader: the key 'path' is missing @ none
[limits] -> [[keyframes]]§\nname = 'a'\n[limits]
    :: keyframes: goes with kind = 'keyframes'; the kind is 'follow_leader'
speed = "5 cm/s"\n -> :: leader: the key 'speed' is missing @ [leader]
"5 cm/s" -> "0 cm/s" :: leader.speed: is '0 cm/s'; allowed: more than 0
"45 mm" -> "1 um" :: leader.pipe: is '1 um' | 'um' is not a known unit
"45 mm" -> "0.01 mm" :: leader.pipe: is '0.01 mm'; allowed: 0.00025 m or more, 1/1000 of the arm
PATH -> path = { type = "line", a = [0, 0, 0], b = [9e3, 0, 0] } :: leader.path: is 9000 m long
depth = 0.1 -> depth = -0.1 :: leader.depth: is -0.1; allowed: more than 0
"45 mm" -> "0 mm" :: leader.pipe: is '0 mm'; allowed: more than 0
depth = 0.1 -> method = "smooth" :: leader.method: is 'smooth'; allowed: 'closest', 'sequential'
depth = 0.1 -> placement = "translate" :: leader.placement: is 'translate'; allowed: 'align', 'as_is'
depth = 0.1 -> dept = 0.1 :: leader.dept: there is no such key (did you mean 'depth'?)
PATH -> path = "S" :: leader.path: is 'S'
cycle = "200 ms" -> position_margin = "1 deg" :: limits.position_margin | turns and slides
"""

LEADER_SEARCHED = r"""
feed = { stroke = "30 cm" }\n -> :: leader.path: first joints of the arm | feed @ path =
"30 cm" -> "5 cm" :: leader.depth: is 0.1; allowed: at most 0.05 m: the feed has 0.05 m of travel @ depth =
[0.2, 0, 0], [0.3, 0.1, 0] -> [0.05, 0, 0.01], [0, 0, 0] :: module 5 | gentler path @ path =
"5 cm/s" -> 1e-9 :: leader.speed: is 1e-09; allowed: a speed for at most 1000000 rows; this one needs 6e+08
"45 mm" -> "1e5 m" :: leader.pipe: radius
[leader] -> [start]§\njoints = [0, 1, 0, 0, 0, 0, 0, 0, 0, ]\n[leader] :: start: start is | straight
pipe = "45 mm" -> placement = "as_is" :: leader.path: start of the path is | base of the arm @ path =
"""
