// The joints of an arm, on a port that the sketch chooses.
#include <ArduinoHardware.h>
#include <ros.h>
#include <ros/time.h>
#include <sensor_msgs/JointState.h>

class NewHardware : public ArduinoHardware {
 public:
  NewHardware() : ArduinoHardware(&Serial, 57600) {}
};

ros::NodeHandle_<NewHardware, 5, 5, 64, 256> nh;
sensor_msgs::JointState robot_state;
ros::Publisher pub("joint_states", &robot_state);
char robot_id[] = "arm";
char* names[2] = {(char*)"shoulder", (char*)"elbow"};
float pos[2];
float vel[2];

void setup() {
  nh.initNode();
  nh.advertise(pub);
  robot_state.header.frame_id = robot_id;
  robot_state.name_length = 2;
  robot_state.name = names;
  robot_state.position_length = 2;
  robot_state.position = pos;
  robot_state.velocity_length = 2;
  robot_state.velocity = vel;
}

void loop() {
  pos[0] = 0.5;
  robot_state.position[1] = pos[0] + 1.0;
  vel[1] = 0.25;
  robot_state.header.stamp = nh.now();
  pub.publish(&robot_state);
  nh.spinOnce();
  delay(10);
}
