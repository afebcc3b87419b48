// Work that gets a turn with each turn of the node, also while a call or a parameter is pending.
#pragma once

namespace ros {

class Node;

class Task {
 public:
  virtual void spin(Node& node) = 0;

 protected:
  Task() {}
  Task(const Task&) = delete;
  Task& operator=(const Task&) = delete;
  ~Task() {}
  Node* node() const { return node_; }  // nullptr: not attached

 private:
  friend class Node;

  Node* node_ = nullptr;
  Task* next_ = nullptr;
};

}  // namespace ros
