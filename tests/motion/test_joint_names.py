"""Names of real files, by family: which joint plays which role. The families are those of public repositories."""

import pytest

from moveset.motion.joint_names import NEEDED, recognise
from moveset.motion.rigs import RIGS
from moveset.motion.skeleton import HML22

# Trunk from the pelvis upwards, leg and arm of the left side, each joint below the one before it. Behind "=" stands the
# role that a joint plays; the arms hang on the joint with a star.
FAMILIES = {
    "SMPL": """
        pelvis=p spine1=1 spine2=2 spine3=3* neck=n head=h /
        left_hip=h left_knee=k left_ankle=a left_foot=f /
        left_collar=c left_shoulder=s left_elbow=e left_wrist=w left_hand""",
    "Mixamo, three.js": """
        mixamorigHips=p mixamorigSpine=1 mixamorigSpine1=2 mixamorigSpine2=3* mixamorigNeck=n
        mixamorigHead=h /
        mixamorigLeftUpLeg=h mixamorigLeftLeg=k mixamorigLeftFoot=a mixamorigLeftToeBase=f /
        mixamorigLeftShoulder=c mixamorigLeftArm=s mixamorigLeftForeArm=e mixamorigLeftHand=w""",
    "Mixamo, underscore": """
        mixamorig_Hips=p mixamorig_Spine=1 mixamorig_Spine1=2 mixamorig_Spine2=3* mixamorig_Neck=n
        mixamorig_Head=h /
        mixamorig_LeftUpLeg=h mixamorig_LeftLeg=k mixamorig_LeftFoot=a mixamorig_LeftToeBase=f /
        mixamorig_LeftShoulder=c mixamorig_LeftArm=s mixamorig_LeftForeArm=e mixamorig_LeftHand=w""",
    "Sketchfab": """
        mixamorig:Hips_01=p mixamorig:Spine_02=1 mixamorig:Spine1_03=2 mixamorig:Spine2_04=3*
        mixamorig:Neck_05=n mixamorig:Head_06=h /
        mixamorig:LeftUpLeg_055=h mixamorig:LeftLeg_056=k mixamorig:LeftFoot_057=a /
        mixamorig:LeftShoulder_08=c mixamorig:LeftArm_09=s mixamorig:LeftForeArm_010=e
        mixamorig:LeftHand_011=w""",
    "copies in Blender": """
        Hips.001=p Spine.001=1 Chest.001=3* Neck.001=n Head.001=h /
        UpLeg.L.001=h Leg.L.001=k Foot.L.001=a /
        Shoulder.L.001=c Arm.L.001=s ForeArm.L.001=e Hand.L.001=w""",
    "Daz (MocapNET)": """
        hip=p abdomen=1 chest=3* neck=n head=h /
        lButtock lThigh=h lShin=k lFoot=a /
        lCollar=c lShldr=s lForeArm=e lHand=w""",
    "MocapNET, neck1": """
        hip=p abdomen=1 chest=3* neck=n neck1 head=h /
        lButtock lThigh=h lShin=k lFoot=a /
        lCollar=c lShldr=s lForeArm=e lHand=w""",
    "pose editor": """
        hip=p abdomen=1 chest=3* neck=n head=h /
        lThigh=h lShin=k lFoot=a /
        lCollar=c lShldr=s lForeArm=e lHand=w""",
    "Biovision, Ab": """
        Hips=p Ab=1 Chest=3* Neck=n Head=h /
        LeftHip=h LeftKnee=k LeftAnkle=a /
        LeftCollar=c LeftShoulder=s LeftElbow=e LeftWrist=w""",
    "Biovision": """
        Hips=p Chest=3* Neck=n Head=h /
        LeftHip=h LeftKnee=k LeftAnkle=a /
        LeftCollar=c LeftShoulder=s LeftElbow=e LeftWrist=w""",
    "Biovision, Chest2": """
        Hips=p Chest=1 Chest2=3* Neck=n Head=h /
        LeftHip=h LeftKnee=k LeftAnkle=a /
        LeftCollar=c LeftShoulder=s LeftElbow=e LeftWrist=w""",
    "Biovision, Abdomen": """
        Hip=p Abdomen=1 Chest=3* Neck=n Head=h /
        LeftHip=h LeftKnee=k LeftAnkle=a /
        LeftCollar=c LeftShoulder=s LeftElbow=e LeftWrist=w""",
    "Biovision, Chest4": """
        Hips=p Chest=1 Chest2 Chest3=2 Chest4=3* Neck=n Head=h /
        LeftHip=h LeftKnee=k LeftAnkle=a LeftToe=f /
        LeftCollar=c LeftShoulder=s LeftElbow=e LeftWrist=w""",
    "UpArm, LowArm": """
        Hips=p Chest=3* Neck=n Head=h /
        LeftUpLeg=h LeftLowLeg=k LeftFoot=a /
        LeftCollar=c LeftUpArm=s LeftLowArm=e LeftHand=w""",
    "animated drawings": """
        Hips=p lowerback=1 Chest=2 Chest2=3* lowerneck=n Neck Head=h /
        LHipJoint LeftHip=h LeftKnee=k LeftAnkle=a LeftToe=f /
        LeftCollar=c LeftShoulder=s LeftElbow=e LeftWrist=w lhand""",
    "Character Creator": """
        CC_Base_Hip=p CC_Base_Waist=1 CC_Base_Spine01=2 CC_Base_Spine02=3* CC_Base_NeckTwist01=n
        CC_Base_Head=h /
        CC_Base_Pelvis CC_Base_L_Thigh=h CC_Base_L_Calf=k CC_Base_L_Foot=a CC_Base_L_ToeBase=f /
        CC_Base_L_Clavicle=c CC_Base_L_Upperarm=s CC_Base_L_Forearm=e CC_Base_L_Hand=w""",
    "smartbody, fingers": """
        Hip=p LowerSpine=1 MiddleSpine=2 Chest=3* Neck=n Head=h /
        LThigh=h LShin=k LFoot=a LToe=f /
        LClavicle=c LShoulder=s LForearm=e LHand=w LFinger1""",
    "smartbody, Jt": """
        JtRoot=p JtSpineA=1 JtSpineB=2 JtSpineC=3* JtNeckA=n JtNeckB JtSkullA=h /
        JtHipLf=h JtKneeLf=k JtAnkleLf=a JtBallLf=f /
        JtClavicleLf=c JtShoulderLf=s JtElbowLf=e JtWristLf=w""",
    "smartbody, base": """
        base=p spine1=1 spine2 spine3=2 spine4=3* spine5=n skullbase=h /
        l_hip=h l_knee=k l_ankle=a l_forefoot=f /
        l_sternoclavicular=c l_acromioclavicular l_shoulder=s l_elbow=e l_wrist=w""",
    "ReActIdle": """
        pelvis=p spine=1 spine.001=3* neck=n face=h /
        thigh.L=h shin.L=k foot.L=a /
        shoulder.L=c upper_arm.L=s forearm.L=e""",
    "GAMES-105": """
        RootJoint=p pelvis_lowerback=1 lowerback_torso=3* torso_head=h /
        lHip=h lKnee=k lAnkle=a lToeJoint=f /
        lTorso_Clavicle=c lShoulder=s lElbow=e lWrist=w""",
    "MotionBuilder": """
        Character1_Hips=p Character1_Spine=1 Character1_Spine1=3* Character1_Neck=n Character1_Head=h /
        Character1_LeftUpLeg=h Character1_LeftLeg=k Character1_LeftFoot=a Character1_LeftToeBase=f /
        Character1_LeftShoulder=c Character1_LeftArm=s Character1_LeftForeArm=e Character1_LeftHand=w""",
    "MotionBuilder, meshes": """
        Character1_Hips=p Character1_Spine=1 Character1_Spine1=3* Character1_Neck=n Character1_Head=h /
        Character1_LeftUpLeg=h Character1_LeftLeg=k Character1_LeftFoot=a Character1_LeftToeBase=f /
        Character1_LeftShoulder=c Character1_LeftArm=s Character1_LeftForeArm=e Character1_LeftHand=w
        L_Radius_RIGMESH L_Humerus_RIGMESH""",
    "MotionBuilder, bare meshes": """
        Character1_Hips=p Character1_Spine=1 Character1_Spine1=3* Character1_Neck=n Character1_Head=h Torso /
        Character1_LeftUpLeg=h Character1_LeftLeg=k Character1_LeftFoot=a Character1_LeftToeBase=f L_Foot /
        Character1_LeftShoulder=c Character1_LeftArm=s Character1_LeftForeArm=e Character1_LeftHand=w
        L_Radius""",
    "ScaDiver": """
        root=p lowerback=1 upperback=2 chest=3* lowerneck=n upperneck=h /
        lhip=h lknee=k lankle=a ltoe=f /
        lclavicle=c lshoulder=s lelbow=e lwrist=w""",
    "ASF": """
        root=p lowerback=1 upperback=2 thorax=3* neck=n head=h /
        lfemur=h ltibia=k lfoot=a ltoes=f /
        lshoulderjoint=c lhumerus=s lradius=e lhand=w""",
    "SNU": """
        root=p SpineDummy Spine=1 Spine1=3* HEadDummy HEad=h /
        LeftUpLegDummy LeftUpLeg=h LeftLeg=k LeftFoot=a LeftToes=f /
        LeftShoulder1Dummy LeftShoulder1=c LeftArm=s LeftForeArm=e LeftHand=w""",
    "SNU, lower case": """
        hip=p spinedummy spine=1 spine1=3* headdummy head=h /
        leftuplegdummy leftupleg=h leftleg=k leftfoot=a lefttoes=f /
        leftshoulder1dummy leftshoulder1=c leftarm=s leftforearm=e lefthand=w""",
    "SNU, L_Femur": """
        Root=p LowerBack=1 Thorax=3* Neck=n Head=h /
        L_Femur=h L_Tibia=k L_Foot=a L_Toe=f /
        L_Collar=c L_Humerus=s L_Elbow=e L_Wrist=w""",
    "MotionBuilder, LaFAN1": """
        Hips=p Spine=1 Spine1=2 Spine2=3* Neck=n Head=h /
        LeftUpLeg=h LeftLeg=k LeftFoot=a LeftToe=f /
        LeftShoulder=c LeftArm=s LeftForeArm=e LeftHand=w""",
    "Rigify": """
        DEF-hips=p DEF-spine.001=1 DEF-spine.002=2 DEF-spine.003=3* DEF-neck=n DEF-head=h /
        DEF-thigh.L=h DEF-shin.L=k DEF-foot.L=a DEF-toe.L=f /
        DEF-shoulder.L=c DEF-upper_arm.L=s DEF-forearm.L=e DEF-hand.L=w""",
    "metarig": """
        spine=p spine.001=1 spine.002=2 spine.003=3* spine.004=n spine.005 spine.006=h /
        thigh.L=h shin.L=k foot.L=a toe.L=f /
        shoulder.L=c upper_arm.L=s forearm.L=e hand.L=w""",
    "Bip01": """
        Bip01_Pelvis=p Bip01_Spine=1 Bip01_Spine1=2 Bip01_Spine2=3* Bip01_Neck=n Bip01_Head=h /
        Bip01_L_Thigh=h Bip01_L_Calf=k Bip01_L_Foot=a Bip01_L_Toe0=f /
        Bip01_L_Clavicle=c Bip01_L_UpperArm=s Bip01_L_Forearm=e Bip01_L_Hand=w""",
    "Biped": """
        Bip001=p Bip001_Spine=1 Bip001_Spine1=3* Bip001_Neck=n Bip001_Head=h /
        Bip001_Pelvis Bip001_L_Thigh=h Bip001_L_Calf=k Bip001_L_Foot=a Bip001_L_Toe0=f /
        Bip001_L_Clavicle=c Bip001_L_UpperArm=s Bip001_L_Forearm=e Bip001_L_Hand=w""",
    "SOMA": """
        Hips=p Spine1=1 Spine2=2 Chest=3* Neck1=n Neck2 Head=h /
        LeftLeg=h LeftShin=k LeftFoot=a LeftToeBase=f /
        LeftShoulder=c LeftArm=s LeftForeArm=e LeftHand=w""",
    "Unity": """
        Hips=p Spine=1 Chest=2 UpperChest=3* Neck=n Head=h /
        LeftUpperLeg=h LeftLowerLeg=k LeftFoot=a LeftToes=f /
        LeftShoulder=c LeftUpperArm=s LeftLowerArm=e LeftHand=w""",
    "VRoid": """
        J_Bip_C_Hips=p J_Bip_C_Spine=1 J_Bip_C_Chest=2 J_Bip_C_UpperChest=3* J_Bip_C_Neck=n J_Bip_C_Head=h /
        J_Bip_L_UpperLeg=h J_Bip_L_LowerLeg=k J_Bip_L_Foot=a J_Bip_L_ToeBase=f /
        J_Bip_L_Shoulder=c J_Bip_L_UpperArm=s J_Bip_L_LowerArm=e J_Bip_L_Hand=w""",
    "Unreal": """
        pelvis=p spine_01=1 spine_02 spine_03=2 spine_04 spine_05=3* neck_01=n neck_02 head=h /
        thigh_l=h calf_l=k foot_l=a ball_l=f /
        clavicle_l=c upperarm_l=s lowerarm_l=e hand_l=w lowerarm_twist_01_l""",
    "KIT": """
        root=p torso=1 chest=3* neck=n head=h /
        left_hip=h left_knee=k left_ankle=a left_heel left_toe=f /
        left_shoulder=s left_elbow=e left_wrist=w""",
    "deepmimic": """
        root=p chest=3* neck=n /
        left_hip=h left_knee=k left_ankle=a /
        left_shoulder=s left_elbow=e""",
    "Genesis 8": """
        hip=p pelvis=1 abdomenLower abdomenUpper=2 chestLower chestUpper=3* neckLower=n neckUpper head=h /
        lThighBend=h lThighTwist lShin=k lFoot=a lMetatarsals lToe=f /
        lCollar=c lShldrBend=s lShldrTwist lForearmBend=e lForearmTwist lHand=w""",
    "MakeHuman": """
        root=p spine05=1 spine04 spine03=2 spine02 spine01=3* neck01=n neck02 head=h /
        upperleg01.L=h upperleg02.L lowerleg01.L=k lowerleg02.L foot.L=a /
        clavicle.L=c shoulder01.L upperarm01.L=s upperarm02.L lowerarm01.L=e lowerarm02.L wrist.L=w""",
    "Perception Neuron": """
        Robot_Hips=p Robot_Spine=1 Robot_Spine1=2 Robot_Spine2=3* Robot_Neck=n Robot_Head=h /
        Robot_LeftUpLeg=h Robot_LeftLeg=k Robot_LeftFoot=a /
        Robot_LeftShoulder=c Robot_LeftArm=s Robot_LeftForeArm=e Robot_LeftHand=w""",
    "Xsens": """
        Pelvis=p L5=1 L3 T12=2 T8=3* Neck=n Head=h / LeftUpperLeg=h LeftLowerLeg=k LeftFoot=a LeftToe=f /
        LeftShoulder=c LeftUpperArm=s LeftForeArm=e LeftHand=w""",
    "Auto-Rig Pro": """
        root.x=p spine_01.x=1 spine_02.x=3* neck.x=n head.x=h / thigh_stretch.l=h leg_stretch.l=k foot.l=a toes_01.l=f /
        shoulder.l=c arm_stretch.l=s forearm_stretch.l=e hand.l=w""",
    "OptiTrack": """
        Hip=p Ab=1 Chest=3* Neck=n Head=h / LThigh=h LShin=k LFoot=a LToe=f / LShoulder=c LUArm=s LFArm=e LHand=w""",
    "MikuMikuDance": """
        センター=p 下半身=1 上半身=2 上半身2=3* 首=n 頭=h / 左足=h 左ひざ=k 左足首=a 左つま先=f /
        左肩=c 左腕=s 左ひじ=e 左手首=w""",
}
TRUNK = {"p": "pelvis", "1": "spine1", "2": "spine2", "3": "spine3", "n": "neck", "h": "head"}
LEG = {"h": "hip", "k": "knee", "a": "ankle", "f": "foot"}
ARM = {"c": "collar", "s": "shoulder", "e": "elbow", "w": "wrist"}
SWAPS = (
    ("左", "右"),
    ("left", "right"),
    ("Left", "Right"),
    ("_l_", "_r_"),
    (".L", ".R"),
    ("_L_", "_R_"),
    ("L_", "R_"),
    ("Lf", "Rt"),
)


def other_side(name):
    for left, right in SWAPS:
        if left in name:
            return name.replace(left, right, 1)
    if name.endswith(("_l", ".l")):
        return name[:-1] + "r"
    return {"l": "r", "L": "R"}.get(name[0], name[0]) + name[1:]


def tree(text):
    """Joints, parents, and role -> joint of one family."""
    trunk, leg, arm = (part.split() for part in text.split("/"))
    joints, parents, roles = [], [], {}

    def grow(chain, parent, tags, side=""):
        for entry in chain:
            name, _, tag = entry.rstrip("*").partition("=")
            joints.append(other_side(name) if side == "right" else name)
            parents.append(parent)
            parent = len(joints) - 1
            if tag:
                roles[f"{side}_{tags[tag]}" if side else tags[tag]] = parent

    grow(trunk, -1, TRUNK)
    chest = next(k for k, entry in enumerate(trunk) if entry.endswith("*"))
    for side in ("left", "right"):
        grow(leg, 0, LEG, side)
        grow(arm, chest, ARM, side)
    return joints, parents, roles


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("prefix", ["", "Armature|", "rig:"])
def test_families_of_real_files_are_recognised(family, prefix):
    joints, parents, roles = tree(FAMILIES[family])
    found = recognise([prefix + name for name in joints], parents)
    assert not found.missing
    assert {r: joints[j] for r, j in found.roles.items()} == {r: joints[j] for r, j in roles.items()}


@pytest.mark.parametrize("rig", RIGS)
def test_built_in_skeletons_are_recognised_whole(rig):
    found = recognise(RIGS[rig].joints, RIGS[rig].parents).roles
    assert set(HML22.joints) - set(found) == ({"spine2", "left_collar", "right_collar"} if rig == "kit21" else set())


@pytest.mark.parametrize(
    "names",
    [
        "root foot_0_0",
        "base child1 child2 child3",
        "link1 link2 link3 link4",
        "Hips",
        "root X_Axis X_Axis_Ornament X_Ornament_A Y_Axis Y_Axis_Ornament Z_Axis Z_Ornament_B2",
        "lHand metacarpal1.l finger2-1.l finger2-2.l lthumbBase lthumb finger1-2.l",
        "root Hips Spine.001 Spine.002 Head Front_Leg_Upper.R Front_Leg_Lower.R Front_Foot.R Tail_Base Back_Foot.L",
        "Hips Spine Neck Head shoulder_L wing_L wing.001_L shoulder_R wing_R wing.001_R Spine.002",
        "b_Root_00 b_Hip_01 b_Spine01_02 b_Neck_04 b_RightUpperArm_06 b_LeftLeg01_015 b_RightLeg01_019",
    ],
)
def test_what_is_no_human_body_is_not_recognised(names):
    joints = names.split()
    assert recognise(joints, range(-1, len(joints) - 1)).missing


def test_what_is_needed_are_roles():
    assert set(NEEDED) <= set(HML22.joints)
